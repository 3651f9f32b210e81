// SPDX-License-Identifier: Apache-2.0
#include "device/bandwidth.h"

#include <algorithm>

#include "core/vec.h"

namespace svgf {
namespace {

// Not zeros, which memory may handle faster.
struct Fill {
    Vec4* out;

    SVGF_HD void operator()(int i) const {
        const float value = float(unsigned(i) * 2654435761u);
        out[i] = {value, value + 1.0f, value * 0.5f, 1.0f / (value + 1.0f)};
    }
};

struct Copy {
    const Vec4* in;
    Vec4* out;

    SVGF_HD void operator()(int i) const { out[i] = in[i]; }
};

}  // namespace

double measure_copy_bandwidth(Device& device, size_t bytes, int repetitions) {
    const size_t count = std::max<size_t>(bytes / sizeof(Vec4), 1);
    Buffer<Vec4> in(device, count, "copy source"), out(device, count, "copy target");
    device.launch("fill", int(count), Fill{in.data()});
    std::vector<double> milliseconds;
    for (int i = 0; i < std::max(repetitions, 1) + 1; ++i) {
        device.take_timings();
        device.launch("copy", int(count), Copy{in.data(), out.data()});
        if (i > 0) milliseconds.push_back(device.take_timings().front().second);  // the first one warms up
    }
    std::ranges::nth_element(milliseconds, milliseconds.begin() + milliseconds.size() / 2);
    return 2.0 * count * sizeof(Vec4) / (milliseconds[milliseconds.size() / 2] * 1e-3);
}

}  // namespace svgf
