// SPDX-License-Identifier: Apache-2.0
#include "device/cpu.h"

#include <cstdlib>
#include <cstring>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include "device/device.h"

namespace svgf {
namespace {

constexpr size_t alignment = 64;

#if defined(__linux__)
// Large memory asks for large pages: rays read all over a scene, and a core knows the places of few small pages.
void* allocate_aligned(size_t bytes) {
    constexpr size_t large_page = size_t(2) << 20;
    const size_t page = bytes >= large_page ? large_page : alignment;
    bytes = (bytes + page - 1) / page * page;
    void* const data = std::aligned_alloc(page, bytes);
    if (data && page == large_page) madvise(data, bytes, MADV_HUGEPAGE);  // where it fails, pages are small
    return data;
}
void release_aligned(void* data) { std::free(data); }
#else
void* allocate_aligned(size_t bytes) { return ::operator new(bytes, std::align_val_t{alignment}, std::nothrow); }
void release_aligned(void* data) { ::operator delete(data, std::align_val_t{alignment}); }
#endif

}  // namespace

Device::Device(int index) {
    if (index != 0) throw DeviceError("", "There is only one CPU device.", "Ask for device \"cpu\".");
}

void* Device::allocate(size_t bytes, const char* what) {
    // One byte at least: an empty buffer still has an address of its own.
    void* data = allocate_aligned(std::max<size_t>(bytes, 1));
    if (!data)
        throw OutOfMemory("", "No memory for " + std::string(what) + " (" + std::to_string(bytes >> 20) + " MiB).",
                          "Render smaller, or close other programs.");
    return data;
}

void Device::release(void* data) noexcept { release_aligned(data); }

void Device::upload(void* device, const void* host, size_t bytes) {
    if (bytes) std::memcpy(device, host, bytes);
}
void Device::download(void* host, const void* device, size_t bytes) { upload(host, device, bytes); }
void Device::copy(void* to, const void* from, size_t bytes) { upload(to, from, bytes); }
void Device::clear(void* device, size_t bytes) { std::memset(device, 0, bytes); }

std::vector<std::pair<std::string, double>> Device::take_timings(bool by_launch) {
    std::vector<std::pair<std::string, double>> timings;
    for (const auto& [launch, milliseconds] : std::exchange(launches_, {})) {
        const std::string_view stage = by_launch ? launch : launch.substr(0, launch.find(' '));
        const auto known =
            std::find_if(timings.begin(), timings.end(), [&](const auto& row) { return row.first == stage; });
        if (known != timings.end())
            known->second += milliseconds;
        else
            timings.emplace_back(stage, milliseconds);
    }
    return timings;
}

void Device::add_timing(std::string_view name, double milliseconds) {
    for (auto& [known, total] : launches_)
        if (known == name) {
            total += milliseconds;
            return;
        }
    launches_.emplace_back(name, milliseconds);
}

std::vector<DeviceInfo> list_devices() {
#if defined(__AVX2__)
    const std::string instructions = "AVX2";
#else
    const std::string instructions = "baseline instructions";
#endif
    const int threads = thread_count();
    return {{instructions + ", " + std::to_string(threads) + (threads == 1 ? " thread" : " threads"), 0, ""}};
}

}  // namespace svgf
