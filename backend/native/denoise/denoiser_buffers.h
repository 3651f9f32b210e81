// SPDX-License-Identifier: Apache-2.0
// The denoiser's memory: which buffers a method needs, where in them each signal's images lie, and the launch of a
// stage on them. Members of Denoiser that several of its sources use.
#pragma once

#include <type_traits>

#include "denoise/denoiser.h"
#include "denoise/method.h"

namespace svgf {

// run.operator()<Method>() for the traits of the denoiser's method.
template <class Run>
auto Denoiser::with_method(Run run) {
    return method_ == DenoiseMethod::svgf_plus ? run.template operator()<Plus>() : run.template operator()<Published>();
}

template <class Storage>
void Denoiser::allocate(int signals) {
    const auto need = [&](Memory& memory, int bytes_per_pixel, const char* what) {
        if (memory.size() < pixels() * bytes_per_pixel) {
            memory = {};
            memory = Memory(device_, pixels() * bytes_per_pixel, what);
            has_history_ = false;
        }
    };
    const int color_bytes = signals * Storage::color_bytes;
    constexpr bool plus = std::is_same_v<Storage, PackedStorage>;
    const int guide_bytes = Storage::guide_bytes + (plus ? 0 : Storage::gradient_bytes);
    need(guides_, guide_bytes, "guides");
    if (method_ != DenoiseMethod::svgf_plus) need(working_, color_bytes, "working colour");
    if (!is_temporal()) {
        if (method_ != DenoiseMethod::none) need(scratch_, color_bytes, "scratch colour");
        return;
    }
    // Previous guides become scratch: all of it, or the second signal's and the resolved colour.
    static_assert((plus ? 1 : max_signals) * Storage::color_bytes <=
                  Storage::guide_bytes + (plus ? 0 : Storage::gradient_bytes));
    need(previous_guides_, guide_bytes, "previous guides");
    need(history_, color_bytes, "history");
    need(moments_, signals * Storage::moments_bytes, "moments");
    need(previous_moments_, signals * Storage::moments_bytes, "previous moments");
    if (method_ != DenoiseMethod::svgf_plus) return;
    need(next_history_, color_bytes, "next history");
    static_assert(!plus || Storage::color_bytes == Storage::guide_bytes);  // they change places
    need(resolved_, Storage::color_bytes, "resolved colour");
}

template <class Storage>
typename Storage::Guides Denoiser::guides_of(Memory& memory) {
    return {memory.data(), width_, height_};
}

template <class Storage>
typename Storage::Gradients Denoiser::gradients() {
    return {borrowed_gradients_ ? borrowed_gradients_ : guides_.data() + pixels() * Storage::guide_bytes};
}

template <class Storage>
typename Storage::Color Denoiser::color_of(Place place, int signal) {
    if (place == Place::working && borrowed_working_[signal]) return {borrowed_working_[signal]};
    Memory& memory = place == Place::working               ? working_
                     : place == Place::history             ? history_
                     : method_ == DenoiseMethod::svgf_plus ? next_history_
                     : is_temporal()                       ? previous_guides_
                                                           : scratch_;
    return {memory.data() + signal * pixels() * Storage::color_bytes};
}

template <class Storage>
typename Storage::Moments Denoiser::moments_of(Memory& memory, int signal) {
    return {memory.data() + signal * pixels() * Storage::moments_bytes};
}

template <class Stage>
void Denoiser::launch(const char* name, const Stage& stage) {
    add_traffic(name, stage.bytes_per_pixel());
    device_.launch(name, width_, height_, stage);
}

template <class Stage>
void Denoiser::launch_tiles(const char* name, const Stage& stage) {
    add_traffic(name, stage.bytes_per_pixel());
    device_.launch_tiles(name, stage);
}

}  // namespace svgf
