// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "core/platform.h"

namespace svgf {

// A place at the end of a queue, for any number of threads at once: a warp asks once. What is asked for is waited for
// only when it is read, so that several queues can be asked before.
class Reservation {
public:
    SVGF_HD Reservation(std::int32_t* count, bool wanted) {
#if defined(__CUDA_ARCH__)
        wanting_ = __ballot_sync(__activemask(), wanted);
        if (lane() == leader()) first_ = atomicAdd(count, __popc(wanting_));
#else
        if (wanted) first_ = std::atomic_ref(*count).fetch_add(1, std::memory_order_relaxed);
#endif
    }

    // Of those alone that wanted one.
    SVGF_HD std::int32_t place() const {
#if defined(__CUDA_ARCH__)
        return __shfl_sync(wanting_, first_, leader()) + __popc(wanting_ & ((1u << lane()) - 1));
#else
        return first_;
#endif
    }

private:
#if defined(__CUDA_ARCH__)
    __device__ static int lane() { return int(threadIdx.x + threadIdx.y * blockDim.x) & 31; }
    __device__ int leader() const { return __ffs(int(wanting_)) - 1; }

    unsigned wanting_;
#endif
    std::int32_t first_ = 0;
};

SVGF_HD inline std::int32_t append(std::int32_t* count) { return Reservation(count, true).place(); }

}  // namespace svgf
