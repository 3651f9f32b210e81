// SPDX-License-Identifier: Apache-2.0
#include "device/threads.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace svgf {
namespace {

struct Loop {
    Loop(size_t count, size_t grain, const std::function<void(size_t, size_t)>& body)
        : count(count), grain(grain), body(body) {}

    const size_t count, grain;
    const std::function<void(size_t, size_t)>& body;
    std::atomic<size_t> next{0};
    std::mutex error_mutex;
    std::exception_ptr error;

    void work() {
        for (;;) {
            const size_t begin = next.fetch_add(grain);
            if (begin >= count) return;
            try {
                body(begin, std::min(begin + grain, count));
            } catch (...) {
                next = count;
                std::lock_guard lock(error_mutex);
                if (!error) error = std::current_exception();
            }
        }
    }
};

thread_local bool inside_loop = false;

// Workers sleep between loops. They start with the first loop, so that importing the module starts no thread.
class Pool {
public:
    explicit Pool(int workers) {
        for (int i = 0; i < workers; ++i) threads_.emplace_back([this] { run(); });
    }

    ~Pool() {
        {
            std::lock_guard lock(mutex_);
            stopping_ = true;
        }
        wake_.notify_all();
        for (auto& thread : threads_) thread.join();
    }

    void run_loop(Loop& loop) {
        std::lock_guard turn(turn_);
        {
            std::lock_guard lock(mutex_);
            loop_ = &loop;
            ++generation_;
            busy_ = threads_.size();
        }
        wake_.notify_all();
        inside_loop = true;
        loop.work();
        inside_loop = false;
        std::unique_lock lock(mutex_);
        done_.wait(lock, [this] { return busy_ == 0; });
        loop_ = nullptr;
    }

private:
    void run() {
        inside_loop = true;
        size_t seen = 0;
        for (;;) {
            Loop* loop;
            {
                std::unique_lock lock(mutex_);
                wake_.wait(lock, [&] { return stopping_ || generation_ != seen; });
                if (stopping_) return;
                seen = generation_;
                loop = loop_;
            }
            loop->work();
            std::lock_guard lock(mutex_);
            if (--busy_ == 0) done_.notify_one();
        }
    }

    std::mutex turn_, mutex_;
    std::condition_variable wake_, done_;
    std::vector<std::thread> threads_;
    Loop* loop_ = nullptr;
    size_t generation_ = 0, busy_ = 0;
    bool stopping_ = false;
};

// Leaked on purpose: joining threads while the process or the interpreter shuts down can hang.
Pool& pool() {
    static Pool* const shared = new Pool(thread_count() - 1);
    return *shared;
}

}  // namespace

int thread_count() {
    static const int count = [] {
        const char* wanted = std::getenv("SVGF_THREADS");
        const int number = wanted ? std::atoi(wanted) : 0;
        return std::clamp(number > 0 ? number : int(std::thread::hardware_concurrency()), 1, 1024);
    }();
    return count;
}

void parallel_for(size_t count, size_t grain, const std::function<void(size_t, size_t)>& body) {
    if (count == 0) return;
    Loop loop(count, std::max<size_t>(grain, 1), body);
    if (inside_loop || count <= loop.grain || thread_count() == 1) {
        loop.work();
    } else {
        pool().run_loop(loop);
    }
    if (loop.error) std::rethrow_exception(loop.error);
}

void parallel_for(size_t count, const std::function<void(size_t, size_t)>& body) {
    parallel_for(count, count / (size_t(thread_count()) * 8) + 1, body);
}

}  // namespace svgf
