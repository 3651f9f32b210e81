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

// The same for several queues and for all threads of a block of so many that are left, once: the block asks once, and
// its threads keep their order, so that what lies together stays together. Sets the places in the queues that are
// wanted. With a warp asking for each, Sponza takes 8.2 instead of 7.9 ms (H200).
template <int threads, int queues>
SVGF_HD inline void append_together(std::int32_t* const (&count)[queues], const bool (&wanted)[queues],
                                    std::int32_t (&place)[queues]) {
#if defined(__CUDA_ARCH__)
    // The numbers of all queues in one word.
    constexpr int warps = threads / 32, bits = 10, mask = (1 << bits) - 1;
    static_assert(threads <= mask && queues * bits < 32);
    __shared__ int of_warp[warps], of_block[queues];
    const int thread = int(threadIdx.x + threadIdx.y * blockDim.x), warp = thread >> 5;
    // The first thread is there if any is; whole warps may be gone.
    if (thread == 0)
        for (int i = 0; i < warps; ++i) of_warp[i] = 0;
    __syncthreads();
    int own = 0;
    for (int i = 0; i < queues; ++i) {
        const unsigned together = __ballot_sync(0xffffffffu, wanted[i]);  // of those that are left
        place[i] = __popc(together & ((1u << (thread & 31)) - 1));
        own |= __popc(together) << (bits * i);
    }
    of_warp[warp] = own;
    __syncthreads();
    int before = 0, all = 0;
    for (int i = 0; i < warps; ++i) {
        before += i < warp ? of_warp[i] : 0;
        all += of_warp[i];
    }
    if (thread == 0)
        for (int i = 0; i < queues; ++i) of_block[i] = atomicAdd(count[i], (all >> (bits * i)) & mask);
    __syncthreads();
    for (int i = 0; i < queues; ++i) place[i] += of_block[i] + ((before >> (bits * i)) & mask);
#else
    for (int i = 0; i < queues; ++i)
        if (wanted[i]) place[i] = append(count[i]);
#endif
}

}  // namespace svgf
