// SPDX-License-Identifier: Apache-2.0
// The CPU device: stages run in tiles on all cores.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "device/error.h"
#include "device/threads.h"

namespace svgf {

class Device : public std::enable_shared_from_this<Device> {
public:
    // Whether stage "path" takes all paths from vertex to vertex together, or one path after the other to its end.
    static constexpr bool follows_paths_together = false;

    explicit Device(int index = 0);
    Device(const Device&) = delete;
    Device& operator=(const Device&) = delete;

    void* allocate(size_t bytes, const char* what);
    void release(void* data) noexcept;
    void upload(void* device, const void* host, size_t bytes);
    void download(void* host, const void* device, size_t bytes);
    void copy(void* to, const void* from, size_t bytes);
    void clear(void* device, size_t bytes);
    void synchronize() {}

    template <class Stage>
    void launch(const char* name, int width, int height, const Stage& stage) {
        const int columns = (width + tile_size - 1) / tile_size, rows = (height + tile_size - 1) / tile_size;
        timed(name, size_t(columns) * rows, 1, [&](size_t begin, size_t end) {
            for (size_t tile = begin; tile < end; ++tile) {
                const int x0 = int(tile % columns) * tile_size, y0 = int(tile / columns) * tile_size;
                const int x1 = std::min(x0 + tile_size, width), y1 = std::min(y0 + tile_size, height);
                if constexpr (requires { stage.trace_tile(x0, y0, x1, y1); })
                    stage.trace_tile(x0, y0, x1, y1);
                else
                    for (int y = y0; y < y1; ++y)
                        for (int x = x0; x < x1; ++x) stage(x, y);
            }
        });
    }

    // See device/device.h.
    template <class Stage>
    void launch_tiles(const char* name, const Stage& stage) {
        const int columns = stage.tile_columns(), rows = stage.tile_rows();
        timed(name, size_t(columns) * rows, 1, [&](size_t begin, size_t end) {
            const auto tile = std::make_unique<typename Stage::Tile>();
            for (size_t t = begin; t < end; ++t) {
                const int column = int(t % columns), row = int(t / columns);
                for (int i = 0; i < Stage::places; ++i) stage.put(*tile, i, stage.fetch(column, row, i));
                for (int y = 0; y < Stage::threads_y; ++y)
                    for (int x = 0; x < Stage::threads_x; ++x)
                        stage(*tile, stage.fetch_own(column, row, x, y), column, row, x, y);
            }
        });
    }

    template <class Stage>
    void launch(const char* name, int count, const Stage& stage) {
        timed(name, size_t(std::max(count, 0)), 4096, [&](size_t begin, size_t end) {
            for (size_t i = begin; i < end; ++i) stage(int(i));
        });
    }

    // The first *count indices, of at most `capacity`.
    template <class Stage>
    void launch_queue(const char* name, int capacity, const std::int32_t* count, const Stage& stage) {
        launch(name, std::min(*count, capacity), stage);
    }

    // For the same source as on CUDA; there are no streams here.
    struct StreamScope {
        StreamScope(Device&, std::optional<uintptr_t>) {}
    };

    // As on CUDA; here one launch runs after the other.
    struct Fork {
        explicit Fork(Device&) {}
        template <class Launches>
        void beside(const Launches& launches) {
            launches();
        }
        void join() {}
    };

    // Milliseconds per stage since the last call, in launch order; by_launch: one row for each of its launches.
    std::vector<std::pair<std::string, double>> take_timings(bool by_launch = false);

    // May be called from any thread: the stage that runs, or else the next one, throws Interrupted.
    void interrupt() { interrupted_ = true; }
    // Forgets an interrupt that came while nothing ran.
    void clear_interrupt() { interrupted_ = false; }

private:
    static constexpr int tile_size = 16;

    template <class Body>
    void timed(const char* name, size_t count, size_t grain, const Body& body) {
        const auto start = std::chrono::steady_clock::now();
        parallel_for(count, grain, [&](size_t begin, size_t end) {
            if (!interrupted_) body(begin, end);
        });
        // Used up here, so that the next frame runs.
        if (interrupted_.exchange(false)) throw Interrupted(name);
        add_timing(name, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count());
    }

    // name: a literal.
    void add_timing(std::string_view name, double milliseconds);

    std::vector<std::pair<std::string_view, double>> launches_;
    std::atomic<bool> interrupted_{false};
};

}  // namespace svgf
