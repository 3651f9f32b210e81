// SPDX-License-Identifier: Apache-2.0
#include "device/cpu.h"

#include <cstring>

#include "device/device.h"
#include "device/large_pages.h"

namespace svgf {
namespace {

// Leaked on purpose: buffers may be released while the process shuts down.
LargePages& memory() {
    static LargePages* const shared = new LargePages;
    return *shared;
}

}  // namespace

Device::Device(int index) {
    if (index != 0) throw DeviceError("", "There is only one CPU device.", "Ask for device \"cpu\".");
}

void* Device::allocate(size_t bytes, const char* what) {
    // One byte at least: an empty buffer still has an address of its own.
    void* data = memory().allocate(std::max<size_t>(bytes, 1));
    if (!data)
        throw OutOfMemory("", "No memory for " + std::string(what) + " (" + std::to_string(bytes >> 20) + " MiB).",
                          "Render smaller, or close other programs.");
    return data;
}

void Device::release(void* data) noexcept { memory().release(data); }

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
