// SPDX-License-Identifier: Apache-2.0
// The CUDA device: a stream of its own or, for a while, a caller's; an event on each side of a launch for the timings.
#pragma once

#include <cuda_runtime_api.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "device/error.h"
#include "device/launch_shape.h"

namespace svgf {

#if defined(__CUDACC__)
template <class Stage, int threads, int blocks>
__global__ void __launch_bounds__(threads, blocks)
    run_stage(const __grid_constant__ Stage stage, int width, int height) {
    const int x = blockIdx.x * blockDim.x + threadIdx.x, y = blockIdx.y * blockDim.y + threadIdx.y;
    if (x < width && y < height) stage(x, y);
}

template <class Stage>
__global__ void __launch_bounds__(Stage::threads_x * Stage::threads_y, Stage::blocks)
    run_tiles(const __grid_constant__ Stage stage) {
    using Tile = typename Stage::Tile;
    // Raw bytes: shared memory has no constructors.
    __shared__ alignas(16) unsigned char memory[sizeof(Tile)];
    Tile& tile = *reinterpret_cast<Tile*>(memory);
    constexpr int threads = Stage::threads_x * Stage::threads_y;
    constexpr int rounds = (Stage::places + threads - 1) / threads;
    const int first = threadIdx.y * Stage::threads_x + threadIdx.x;
    const auto own = stage.fetch_own(blockIdx.x, blockIdx.y, threadIdx.x, threadIdx.y);
    // Several reads are on their way before the first of them is waited for.
#pragma unroll
    for (int begin = 0; begin < rounds; begin += Stage::fetches) {
        typename Stage::Texel texels[Stage::fetches];
        // The compiler leaves out what no thread, and the test where every thread has something to read.
        const auto has = [&](int round) {
            return round < rounds &&
                   ((round + 1) * threads <= Stage::places || first + round * threads < Stage::places);
        };
#pragma unroll
        for (int i = 0; i < Stage::fetches; ++i)
            if (has(begin + i)) texels[i] = stage.fetch(blockIdx.x, blockIdx.y, first + (begin + i) * threads);
#pragma unroll
        for (int i = 0; i < Stage::fetches; ++i)
            if (has(begin + i)) stage.put(tile, first + (begin + i) * threads, texels[i]);
    }
    __syncthreads();
    stage(tile, own, blockIdx.x, blockIdx.y, threadIdx.x, threadIdx.y);
}

template <class Stage>
__global__ void __launch_bounds__(128) run_stage(const __grid_constant__ Stage stage, int count) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i < count) stage(i);
}

template <class Stage, int threads, int blocks>
__global__ void __launch_bounds__(threads, blocks)
    run_queue(const __grid_constant__ Stage stage, const int* count) {
    const int i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i < *count) stage(i);
}
#endif

class Device : public std::enable_shared_from_this<Device> {
public:
    // Whether stage "path" takes all paths from vertex to vertex together, or one path after the other to its end.
    static constexpr bool follows_paths_together = true;

    explicit Device(int index = 0);
    ~Device();
    Device(const Device&) = delete;
    Device& operator=(const Device&) = delete;

    // Memory is ordered on the device's stream and comes from its pool, so that a frame's images cost no driver call
    // after the first frame.
    void* allocate(size_t bytes, const char* what);
    void release(void* data) noexcept;
    void upload(void* device, const void* host, size_t bytes);
    void download(void* host, const void* device, size_t bytes);
    void copy(void* to, const void* from, size_t bytes);
    void clear(void* device, size_t bytes);
    void synchronize();

    // Host memory that the device writes to without a detour: several times as fast, but slow to get, so what is
    // given back is kept for the next. Ordinary memory once much of it is in use. Any thread may give it back.
    std::shared_ptr<void> host_memory(size_t bytes);

#if defined(__CUDACC__)
    template <class Stage>
    void launch(const char* name, int width, int height, const Stage& stage) {
        if (width <= 0 || height <= 0) return;
        begin_stage(name);
        constexpr LaunchShape shape = launch_shape_of<Stage>();
        const dim3 block(shape.width, shape.height);
        const dim3 grid((width + shape.width - 1) / shape.width, (height + shape.height - 1) / shape.height);
        run_stage<Stage, shape.width * shape.height, shape.blocks><<<grid, block, 0, stream()>>>(stage, width, height);
        end_stage(name);
    }

    // See device/device.h.
    template <class Stage>
    void launch_tiles(const char* name, const Stage& stage) {
        begin_stage(name);
        const dim3 block(Stage::threads_x, Stage::threads_y), grid(stage.tile_columns(), stage.tile_rows());
        run_tiles<<<grid, block, 0, stream()>>>(stage);
        end_stage(name);
    }

    template <class Stage>
    void launch(const char* name, int count, const Stage& stage) {
        if (count <= 0) return;
        begin_stage(name);
        run_stage<<<(count + 127) / 128, 128, 0, stream()>>>(stage, count);
        end_stage(name);
    }

    // The first *count indices, of at most `capacity`; the host does not wait to know how many they are.
    template <class Stage>
    void launch_queue(const char* name, int capacity, const std::int32_t* count, const Stage& stage) {
        if (capacity <= 0) return;
        begin_stage(name);
        constexpr LaunchShape shape = launch_shape_of<Stage>();
        constexpr int threads = shape.width * shape.height;
        run_queue<Stage, threads, shape.blocks>
            <<<(capacity + threads - 1) / threads, threads, 0, stream()>>>(stage, count);
        end_stage(name);
    }
#endif

    // Milliseconds per stage since the last call, in launch order: the first word of a launch's name. by_launch: per
    // name. Waits for the device. After thousands of launches the oldest are left out.
    std::vector<std::pair<std::string, double>> take_timings(bool by_launch = false);

    // May be called from any thread: the next launch throws Interrupted. Kernels are short; a running one ends.
    void interrupt() { interrupted_ = true; }
    // Forgets an interrupt that came while nothing ran.
    void clear_interrupt() { interrupted_ = false; }

    int index() const { return index_; }

    // While it lives, all work and allocation is on the caller's stream; nothing given: on the device's own. Work of
    // before and after keeps its order, as the streams wait for each other (the host does not). Afterwards the stream
    // is not touched again, since it may be gone: memory that was allocated on it is kept for it when it is released,
    // as only the stream itself can tell when what was queued there has been read.
    class StreamScope {
    public:
        StreamScope(Device& device, std::optional<uintptr_t> stream);
        ~StreamScope();
        StreamScope(const StreamScope&) = delete;
        StreamScope& operator=(const StreamScope&) = delete;

    private:
        Device* device_;  // null: nothing to undo
    };

    // What another stream does from here on sees all work until now.
    void let_wait(uintptr_t other_stream);

    // Launches that run beside those that come after them, so that neither waits for the other's last threads. They see
    // all work until then; what comes after join(), or after the fork, sees theirs. They must not allocate.
    class Fork {
    public:
        explicit Fork(Device& device) : device_(device) {}
        ~Fork() { device_.join(); }
        Fork(const Fork&) = delete;
        Fork& operator=(const Fork&) = delete;

        template <class Launches>
        void beside(const Launches& launches) {
            const Beside scope(device_);
            launches();
        }
        void join() { device_.check(device_.join(), device_.last_stage_); }

    private:
        Device& device_;
    };

private:
    struct Span {
        const char* name;
        cudaEvent_t begin, end;
    };

    // Blocks of pinned memory by size; shared with the blocks in use, which may outlive the device.
    struct PinnedBlocks {
        ~PinnedBlocks();
        void give_back(void* data, size_t bytes);

        std::mutex mutex;
        std::multimap<size_t, void*> free;
        size_t free_bytes = 0, used_bytes = 0;
    };

    // Where to put the next piece of work; waits for what the last stream had to do.
    cudaStream_t stream();

    // While it lives, launches go to the side stream.
    class Beside {
    public:
        explicit Beside(Device& device);
        ~Beside() { device_.stream_ = main_; }

    private:
        Device& device_;
        cudaStream_t main_;
    };
    cudaError_t join();

    void begin_stage(const char* name);
    void end_stage(const char* name);
    void check(cudaError_t error, const char* stage) const;
    cudaEvent_t new_event();

    int index_ = 0;
    // A blocking stream: it keeps order with the legacy default stream, on which CuPy and PyTorch work by default, so
    // arrays can be handed over in both directions without waiting.
    cudaStream_t own_stream_ = nullptr;
    cudaStream_t stream_ = nullptr;      // that work goes to now
    cudaStream_t side_stream_ = nullptr;
    cudaEvent_t side_work_ = nullptr;
    bool is_forked_ = false;             // nothing waits for the side stream yet
    cudaEvent_t last_work_ = nullptr;    // on a caller's stream
    bool must_wait_ = false;             // the own stream, for last_work_

    // Memory of a caller's stream: the number that no other stream ever gets, bytes.
    using StreamMemory = std::pair<unsigned long long, size_t>;
    std::mutex mutex_;  // of the two: images may die in any thread
    std::map<void*, StreamMemory> in_use_;
    std::multimap<StreamMemory, void*> kept_;

    void free_kept();  // waits for all streams
    cudaMemPool_t pool_ = nullptr;
    bool synchronize_each_stage_ = false;  // SVGF_SYNCHRONIZE=1: the stage that failed is the one named
    const char* last_stage_ = "";
    std::vector<Span> spans_;
    std::vector<cudaEvent_t> free_events_;
    std::atomic<bool> interrupted_{false};
    std::shared_ptr<PinnedBlocks> pinned_ = std::make_shared<PinnedBlocks>();
};

}  // namespace svgf
