// SPDX-License-Identifier: Apache-2.0
// Reads and writes of whole records in device memory.
#pragma once

#include "core/platform.h"

namespace svgf {

// A record, in as few memory instructions as there are: 16 bytes each. Left to itself the device's compiler reads
// member by member. On the host, where a copy costs more than what it saves, the record itself.
#if defined(__CUDACC__)
template <class Record>
SVGF_HD inline Record load(const Record* record) {
    static_assert(alignof(Record) == 16 && sizeof(Record) % 16 == 0);
#if defined(__CUDA_ARCH__)
    union {
        uint4 pieces[sizeof(Record) / 16];
        Record value;
    } copy{};
    const uint4* const pieces = reinterpret_cast<const uint4*>(record);
    SVGF_UNROLL
    for (unsigned i = 0; i < sizeof(Record) / 16; ++i) copy.pieces[i] = pieces[i];
    return copy.value;
#else
    return *record;
#endif
}
#else
template <class Record>
inline const Record& load(const Record* record) {
    return *record;
}
#endif

template <class Record>
SVGF_HD inline void store(Record* record, const Record& value) {
    static_assert(alignof(Record) == 16 && sizeof(Record) % 16 == 0);
#if defined(__CUDA_ARCH__)
    union {
        Record value;
        uint4 pieces[sizeof(Record) / 16];
    } copy{value};
    uint4* const pieces = reinterpret_cast<uint4*>(record);
    SVGF_UNROLL
    for (unsigned i = 0; i < sizeof(Record) / 16; ++i) pieces[i] = copy.pieces[i];
#else
    *record = value;
#endif
}

// Sends for a cache line that will be read soon. A GPU runs other threads meanwhile.
SVGF_HD inline void prefetch([[maybe_unused]] const void* address) {
#if defined(__GNUC__) && !defined(__CUDACC__)
    __builtin_prefetch(address);
#endif
}

}  // namespace svgf
