// SPDX-License-Identifier: Apache-2.0
#include "device/cpu.h"

#include <cstring>
#include <new>

#include "device/device.h"

namespace svgf {
namespace {

constexpr std::align_val_t alignment{64};

}  // namespace

Device::Device(int index) {
    if (index != 0) throw DeviceError("", "There is only one CPU device.", "Ask for device \"cpu\".");
}

void* Device::allocate(size_t bytes, const char* what) {
    // One byte at least: an empty buffer still has an address of its own.
    void* data = ::operator new(std::max<size_t>(bytes, 1), alignment, std::nothrow);
    if (!data)
        throw OutOfMemory("", "No memory for " + std::string(what) + " (" + std::to_string(bytes >> 20) + " MiB).",
                          "Render smaller, or close other programs.");
    return data;
}

void Device::release(void* data) noexcept { ::operator delete(data, alignment); }

void Device::upload(void* device, const void* host, size_t bytes) {
    if (bytes) std::memcpy(device, host, bytes);
}
void Device::download(void* host, const void* device, size_t bytes) { upload(host, device, bytes); }
void Device::copy(void* to, const void* from, size_t bytes) { upload(to, from, bytes); }
void Device::clear(void* device, size_t bytes) { std::memset(device, 0, bytes); }

void Device::add_timing(const char* name, double milliseconds) {
    for (auto& [known, total] : timings_)
        if (known == name) {
            total += milliseconds;
            return;
        }
    timings_.emplace_back(name, milliseconds);
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
