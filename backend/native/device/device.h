// SPDX-License-Identifier: Apache-2.0
// The device that this build of native/ is for. Both have the same members:
//
//   allocate, release, upload, download, copy, clear    device memory
//   launch(name, width, height, stage)                  stage(x, y) for every pixel
//   launch(name, count, stage)                          stage(i) for every index
//   launch_queue(name, capacity, count, stage)          stage(i) for as many as *count, on the device, says
//   launch_tiles(name, stage)                           tiles of pixels that share what they read, see below
//   take_timings, synchronize, interrupt
//   StreamScope                                         work on a caller's stream for a while
//   Fork                                                launches that run beside others
//
// A stage is a plain struct with named fields and `SVGF_HD void operator()(...) const`. Its name is at once the row in
// the timings, the profiler's range and what an error message says. Where one stage takes several launches, theirs go
// on with a space and another word; one launch of several stages has their names with a + between.
//
// A stage of tiles has tile_columns() x tile_rows() tiles of threads_x x threads_y threads. For each of them the Tile,
// shared memory on a GPU, is filled: put(tile, i, fetch(column, row, i)) for every i below places. When all of it is
// there, operator()(tile, own, column, row, x, y) runs for every thread, own being what fetch_own(column, row, x, y)
// has read for it alone in the meantime. A thread of a GPU has `fetches` texels on their way at a time.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#if defined(SVGF_CUDA)
#include "device/cuda.h"
#else
#include "device/cpu.h"
#endif

namespace svgf {

// Device memory for `count` values, freed with the last owner. `what` names it in out-of-memory messages.
template <class T>
class Buffer {
public:
    Buffer() = default;
    Buffer(Device& device, size_t count, const char* what)
        : device_(&device), keep_(device.weak_from_this().lock()),
          data_(static_cast<T*>(device.allocate(count * sizeof(T), what))), size_(count) {}
    Buffer(Device& device, std::span<const T> host, const char* what) : Buffer(device, host.size(), what) {
        upload(host);
    }
    Buffer(Buffer&& other) noexcept { swap(other); }
    Buffer& operator=(Buffer&& other) noexcept {
        Buffer(std::move(other)).swap(*this);
        return *this;
    }
    ~Buffer() {
        if (data_) device_->release(data_);
    }

    T* data() { return data_; }
    const T* data() const { return data_; }
    size_t size() const { return size_; }
    Device& device() const { return *device_; }  // of a buffer that holds memory
    size_t bytes() const { return size_ * sizeof(T); }
    explicit operator bool() const { return data_ != nullptr; }

    void upload(std::span<const T> host) { device_->upload(data_, host.data(), host.size_bytes()); }
    void clear() { device_->clear(data_, bytes()); }
    std::vector<T> download() const {
        std::vector<T> host(size_);
        device_->download(host.data(), data_, bytes());
        return host;
    }
    void swap(Buffer& other) noexcept {
        std::swap(device_, other.device_);
        std::swap(keep_, other.keep_);
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
    }

private:
    Device* device_ = nullptr;
    std::shared_ptr<Device> keep_;  // where the device is shared, memory keeps it alive
    T* data_ = nullptr;
    size_t size_ = 0;
};

struct DeviceInfo {
    std::string name;        // "NVIDIA H200", "AVX2, 16 threads"
    size_t memory_bytes = 0; // 0: the host's
    std::string reason;      // why it cannot be used, empty if it can
};

// What this build finds on this machine, without opening it.
std::vector<DeviceInfo> list_devices();

}  // namespace svgf
