// SPDX-License-Identifier: Apache-2.0
// How a GPU runs a stage. The CPU device does not look at it.
#pragma once

namespace svgf {

struct LaunchShape {
    int width = 32, height = 4;  // of a block, threads; a warp is 32 of them, row by row
    int blocks = 1;              // that a multiprocessor holds at least, which bounds the registers of a thread
};

// Stages that know better hold a member `static constexpr LaunchShape launch_shape`.
template <class Stage>
constexpr LaunchShape launch_shape_of() {
    if constexpr (requires { Stage::launch_shape; })
        return Stage::launch_shape;
    else
        return {};
}

}  // namespace svgf
