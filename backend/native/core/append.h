// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "core/platform.h"

namespace svgf {

// The next free place of a queue, for any number of threads at once: a warp asks once.
SVGF_HD inline std::int32_t append(std::int32_t* count) {
#if defined(__CUDA_ARCH__)
    const unsigned together = __activemask();
    const int lane = int(threadIdx.x + threadIdx.y * blockDim.x) & 31;
    const int leader = __ffs(int(together)) - 1;
    int first = 0;
    if (lane == leader) first = atomicAdd(count, __popc(together));
    return __shfl_sync(together, first, leader) + __popc(together & ((1u << lane) - 1));
#else
    return std::atomic_ref(*count).fetch_add(1, std::memory_order_relaxed);
#endif
}

}  // namespace svgf
