// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdlib>
#include <string_view>
#include <utility>

#include "device/device.h"

#if __has_include(<nvtx3/nvToolsExt.h>)
#include <nvtx3/nvToolsExt.h>
#define SVGF_RANGE_PUSH(name) nvtxRangePushA(name)
#define SVGF_RANGE_POP() nvtxRangePop()
#else
#define SVGF_RANGE_PUSH(name) (void)(name)
#define SVGF_RANGE_POP() (void)0
#endif

namespace svgf {
namespace {

// Launches whose time is kept until it is taken.
constexpr size_t most_spans = 4096;
// Of pinned host memory: kept for later, and in use. A frame's images in 4K are about 1 GiB.
constexpr size_t most_free_pinned_bytes = size_t(512) << 20, most_used_pinned_bytes = size_t(1) << 30;

std::string hint_for(cudaError_t error) {
    switch (error) {
        case cudaErrorInsufficientDriver:
            return "Update the NVIDIA driver: CUDA 13 needs 580 or newer.";
        case cudaErrorNoDevice:
        case cudaErrorInvalidDevice:
            return "Use device \"cpu\", or check that nvidia-smi shows the GPU.";
        case cudaErrorNoKernelImageForDevice:
            return "Install svgf on this machine again, so that it is compiled for this GPU (compute capability 7.5 or newer).";
        default:
            return "Use device \"cpu\" for the rest of this session, or start it again.";
    }
}

}  // namespace

Device::Device(int index) : index_(index) {
    check(cudaSetDevice(index), "");
    check(cudaStreamCreate(&own_stream_), "");
    check(cudaStreamCreateWithFlags(&side_stream_, cudaStreamNonBlocking), "");
    check(cudaEventCreateWithFlags(&last_work_, cudaEventDisableTiming), "");
    check(cudaEventCreateWithFlags(&side_work_, cudaEventDisableTiming), "");
    stream_ = own_stream_;
    // A pool of its own, so that neither other libraries' memory nor the driver's trimming gets mixed up with it.
    cudaMemPoolProps properties = {};
    properties.allocType = cudaMemAllocationTypePinned;
    properties.location = {cudaMemLocationTypeDevice, index};
    check(cudaMemPoolCreate(&pool_, &properties), "");
    uint64_t kept_bytes = uint64_t(2) << 30;  // a frame in 4K; what is free beyond it goes back to the driver
    check(cudaMemPoolSetAttribute(pool_, cudaMemPoolAttrReleaseThreshold, &kept_bytes), "");
    const char* wanted = std::getenv("SVGF_SYNCHRONIZE");
    synchronize_each_stage_ = wanted && wanted[0] == '1';
}

Device::~Device() {
    // The process may be on its way out, or the device lost: nothing here may throw.
    if (!own_stream_) return;
    free_kept();
    if (must_wait_) cudaEventSynchronize(last_work_);
    cudaStreamSynchronize(own_stream_);
    for (auto& span : spans_) {
        cudaEventDestroy(span.begin);
        cudaEventDestroy(span.end);
    }
    for (auto event : free_events_) cudaEventDestroy(event);
    cudaEventDestroy(last_work_);
    cudaEventDestroy(side_work_);
    cudaStreamDestroy(side_stream_);
    cudaStreamDestroy(own_stream_);
    cudaMemPoolDestroy(pool_);
}

void Device::check(cudaError_t error, const char* stage) const {
    if (error == cudaSuccess) return;
    cudaGetLastError();  // a launch error that is not sticky would otherwise be found again by the next check
    const std::string where = stage[0] ? "Stage \"" + std::string(stage) + "\" failed on CUDA: " : "CUDA: ";
    throw DeviceError(stage, where + cudaGetErrorString(error) + ".", hint_for(error));
}

void* Device::allocate(size_t bytes, const char* what) {
    cudaSetDevice(index_);  // the calling thread may have another one
    StreamMemory memory{0, bytes};
    if (stream_ != own_stream_) {
        check(cudaStreamGetId(stream_, &memory.first), last_stage_);
        std::lock_guard lock(mutex_);
        if (const auto found = kept_.find(memory); found != kept_.end()) {
            void* data = found->second;
            kept_.erase(found);
            in_use_[data] = memory;
            return data;
        }
    }
    void* data = nullptr;
    cudaError_t error = cudaMallocFromPoolAsync(&data, bytes ? bytes : 1, pool_, stream());
    if (error == cudaErrorMemoryAllocation) {
        cudaGetLastError();
        free_kept();
        error = cudaMallocFromPoolAsync(&data, bytes ? bytes : 1, pool_, stream());
    }
    if (error == cudaErrorMemoryAllocation) {
        cudaGetLastError();
        size_t free_bytes = 0, total_bytes = 0;
        cudaMemGetInfo(&free_bytes, &total_bytes);
        throw OutOfMemory(last_stage_,
                          "The GPU has no room for " + std::string(what) + " (" + std::to_string(bytes >> 20) +
                              " MiB; " + std::to_string(free_bytes >> 20) + " of " +
                              std::to_string(total_bytes >> 20) + " MiB free).",
                          "Render smaller, close other programs that use the GPU, or use device \"cpu\".");
    }
    check(error, last_stage_);
    if (stream_ != own_stream_) {
        std::lock_guard lock(mutex_);
        in_use_[data] = memory;
    }
    return data;
}

void Device::release(void* data) noexcept {
    {
        std::lock_guard lock(mutex_);
        if (const auto found = in_use_.find(data); found != in_use_.end()) {
            kept_.emplace(found->second, data);
            in_use_.erase(found);
            return;
        }
    }
    if (must_wait_) cudaStreamWaitEvent(own_stream_, last_work_);
    cudaFreeAsync(data, own_stream_);
}

void Device::free_kept() {
    std::lock_guard lock(mutex_);
    if (kept_.empty()) return;
    cudaDeviceSynchronize();
    for (const auto& [memory, data] : kept_) cudaFreeAsync(data, own_stream_);
    kept_.clear();
    cudaStreamSynchronize(own_stream_);
}

cudaStream_t Device::stream() {
    if (must_wait_ && stream_ == own_stream_) {
        check(cudaStreamWaitEvent(own_stream_, last_work_), last_stage_);
        must_wait_ = false;
    }
    return stream_;
}

Device::StreamScope::StreamScope(Device& device, std::optional<uintptr_t> stream)
    : device_(stream ? &device : nullptr) {
    if (!stream) return;
    const auto theirs = reinterpret_cast<cudaStream_t>(*stream);
    if (!device.must_wait_) device.check(cudaEventRecord(device.last_work_, device.own_stream_), device.last_stage_);
    device.check(cudaStreamWaitEvent(theirs, device.last_work_), device.last_stage_);
    device.stream_ = theirs;
}

Device::StreamScope::~StreamScope() {
    if (!device_) return;
    cudaEventRecord(device_->last_work_, device_->stream_);
    device_->stream_ = device_->own_stream_;
    device_->must_wait_ = true;
}

Device::Beside::Beside(Device& device) : device_(device), main_(device.stream()) {
    device.check(cudaEventRecord(device.side_work_, main_), device.last_stage_);
    device.check(cudaStreamWaitEvent(device.side_stream_, device.side_work_), device.last_stage_);
    device.stream_ = device.side_stream_;
    device.is_forked_ = true;
}

cudaError_t Device::join() {
    if (!std::exchange(is_forked_, false)) return cudaSuccess;
    const cudaError_t error = cudaEventRecord(side_work_, side_stream_);
    return error != cudaSuccess ? error : cudaStreamWaitEvent(stream_, side_work_);
}

void Device::let_wait(uintptr_t other_stream) {
    if (!must_wait_) check(cudaEventRecord(last_work_, own_stream_), last_stage_);
    check(cudaStreamWaitEvent(reinterpret_cast<cudaStream_t>(other_stream), last_work_), last_stage_);
}

void Device::upload(void* device, const void* host, size_t bytes) {
    if (bytes) check(cudaMemcpyAsync(device, host, bytes, cudaMemcpyHostToDevice, stream()), last_stage_);
}

void Device::download(void* host, const void* device, size_t bytes) {
    if (bytes) check(cudaMemcpyAsync(host, device, bytes, cudaMemcpyDeviceToHost, stream()), last_stage_);
    synchronize();
}

Device::PinnedBlocks::~PinnedBlocks() {
    for (const auto& [bytes, data] : free) cudaFreeHost(data);
}

void Device::PinnedBlocks::give_back(void* data, size_t bytes) {
    std::lock_guard lock(mutex);
    used_bytes -= bytes;
    if (free_bytes + bytes > most_free_pinned_bytes) {
        cudaFreeHost(data);
        return;
    }
    free.emplace(bytes, data);
    free_bytes += bytes;
}

std::shared_ptr<void> Device::host_memory(size_t bytes) {
    std::lock_guard lock(pinned_->mutex);
    void* data = nullptr;
    if (const auto found = pinned_->free.find(bytes); found != pinned_->free.end()) {
        data = found->second;
        pinned_->free.erase(found);
        pinned_->free_bytes -= bytes;
    } else if (pinned_->used_bytes + bytes > most_used_pinned_bytes ||
               cudaHostAlloc(&data, bytes ? bytes : 1, cudaHostAllocDefault) != cudaSuccess) {
        cudaGetLastError();
        return {::operator new(bytes), [](void* memory) { ::operator delete(memory); }};
    }
    pinned_->used_bytes += bytes;
    return {data, [blocks = pinned_, bytes](void* memory) { blocks->give_back(memory, bytes); }};
}

void Device::copy(void* to, const void* from, size_t bytes) {
    if (bytes) check(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToDevice, stream()), last_stage_);
}

void Device::clear(void* device, size_t bytes) {
    if (bytes) check(cudaMemsetAsync(device, 0, bytes, stream()), last_stage_);
}

void Device::synchronize() { check(cudaStreamSynchronize(stream()), last_stage_); }

cudaEvent_t Device::new_event() {
    if (!free_events_.empty()) {
        const cudaEvent_t event = free_events_.back();
        free_events_.pop_back();
        return event;
    }
    cudaEvent_t event;
    check(cudaEventCreate(&event), last_stage_);
    return event;
}

void Device::begin_stage(const char* name) {
    if (interrupted_.exchange(false)) throw Interrupted(name);
    last_stage_ = name;
    cudaSetDevice(index_);
    if (spans_.size() == most_spans) {  // nobody takes the timings: the older half is forgotten
        for (size_t i = 0; i < most_spans / 2; ++i) {
            free_events_.push_back(spans_[i].begin);
            free_events_.push_back(spans_[i].end);
        }
        spans_.erase(spans_.begin(), spans_.begin() + most_spans / 2);
    }
    SVGF_RANGE_PUSH(name);
    spans_.push_back({name, new_event(), new_event()});
    check(cudaEventRecord(spans_.back().begin, stream()), name);
}

void Device::end_stage(const char* name) {
    SVGF_RANGE_POP();
    const cudaError_t error = cudaGetLastError();
    if (error != cudaSuccess) spans_.pop_back();  // its end would never come
    check(error, name);
    check(cudaEventRecord(spans_.back().end, stream()), name);
    if (synchronize_each_stage_) check(cudaStreamSynchronize(stream()), name);
}

std::vector<std::pair<std::string, double>> Device::take_timings(bool by_launch) {
    synchronize();
    std::vector<std::pair<std::string, double>> timings;
    // Of launches beside each other each moment counts for the one that began first.
    const auto elapsed = [&](cudaEvent_t begin, const Span& span, cudaEvent_t end) {
        float milliseconds = 0;
        check(cudaEventElapsedTime(&milliseconds, begin, end), span.name);
        return milliseconds;
    };
    std::vector<std::pair<float, size_t>> order;
    for (size_t i = 0; i < spans_.size(); ++i)
        order.emplace_back(elapsed(spans_.front().begin, spans_[i], spans_[i].begin), i);
    std::sort(order.begin(), order.end());
    std::vector<float> times(spans_.size());
    float counted_until = 0;
    for (const auto& [begin, i] : order) {
        const float whole = elapsed(spans_[i].begin, spans_[i], spans_[i].end);
        times[i] = std::max(0.0f, whole - std::max(0.0f, counted_until - begin));
        counted_until = std::max(counted_until, begin + whole);
    }
    for (size_t i = 0; i < spans_.size(); ++i) {
        const Span& span = spans_[i];
        const float milliseconds = times[i];
        free_events_.push_back(span.begin);
        free_events_.push_back(span.end);
        const std::string_view launch = span.name;
        const std::string_view stage = by_launch ? launch : launch.substr(0, launch.find(' '));
        const auto known =
            std::find_if(timings.begin(), timings.end(), [&](const auto& row) { return row.first == stage; });
        if (known != timings.end())
            known->second += milliseconds;
        else
            timings.emplace_back(stage, milliseconds);
    }
    spans_.clear();
    return timings;
}

std::vector<DeviceInfo> list_devices() {
    int count = 0;
    const cudaError_t error = cudaGetDeviceCount(&count);
    if (error != cudaSuccess || count == 0) {
        cudaGetLastError();
        const cudaError_t reason = error == cudaSuccess ? cudaErrorNoDevice : error;
        int driver = 0;  // stays 0 where there is no driver at all, which the runtime calls an insufficient one
        cudaDriverGetVersion(&driver);
        if (driver == 0) return {{"-", 0, "There is no NVIDIA driver. Install version 580 or newer to use a GPU."}};
        return {{"-", 0, std::string(cudaGetErrorString(reason)) + ". " + hint_for(reason)}};
    }
    std::vector<DeviceInfo> devices;
    for (int i = 0; i < count; ++i) {
        cudaDeviceProp properties;
        if (cudaGetDeviceProperties(&properties, i) != cudaSuccess) continue;
        DeviceInfo info{properties.name, properties.totalGlobalMem, ""};
        if (properties.major * 10 + properties.minor < 75)
            info.reason = "Its compute capability is below 7.5. Use device \"cpu\".";
        devices.push_back(info);
    }
    return devices;
}

}  // namespace svgf
