// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser_buffers.h"

namespace svgf {

void Denoiser::prepare(int signals) {
    with_method([&]<class Method>() { allocate<typename Method::Storage>(signals); });
}

std::vector<BufferInfo> Denoiser::buffers() const {
    std::vector<BufferInfo> list;
    const auto add = [&](const char* name, const auto& buffer) {
        if (buffer) list.push_back({name, buffer.bytes()});
    };
    add("guides", guides_);
    add("previous guides", previous_guides_);
    add("working colour", working_);
    add("scratch colour", scratch_);
    add("history", history_);
    add("next history", next_history_);
    add("moments", moments_);
    add("previous moments", previous_moments_);
    add("resolved colour", resolved_);
    add("repair counter", repaired_);
    add("firefly counter", fireflies_);
    return list;
}

}  // namespace svgf
