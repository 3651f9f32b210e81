// SPDX-License-Identifier: Apache-2.0
// How fast the device copies memory: what no stage that moves as many bytes can beat.
#pragma once

#include <cstddef>

#include "device/device.h"

namespace svgf {

// Bytes read and written per second by a stage that copies `bytes`, the median of `repetitions`. Takes the timings that
// the device has gathered.
double measure_copy_bandwidth(Device& device, size_t bytes, int repetitions);

}  // namespace svgf
