// SPDX-License-Identifier: Apache-2.0
// All cores of the host, for the CPU device's stages and for builds on any device.
#pragma once

#include <cstddef>
#include <functional>

namespace svgf {

// Number of threads that parallel_for uses, the caller's included. SVGF_THREADS in the environment overrides it.
int thread_count();

// Calls body(begin, end) until [0, count) is covered, in chunks of `grain`, on all threads; returns when all are done.
// Calls from different threads take turns; a call from inside body runs on the calling thread alone. The first
// exception that a body throws ends the loop early and is rethrown here.
void parallel_for(size_t count, size_t grain, const std::function<void(size_t begin, size_t end)>& body);

// The same with a grain that gives each thread about eight chunks.
void parallel_for(size_t count, const std::function<void(size_t begin, size_t end)>& body);

}  // namespace svgf
