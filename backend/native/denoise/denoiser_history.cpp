// SPDX-License-Identifier: Apache-2.0
// What a denoiser knows from one frame to the next: over a change of size, and for whoever asks for it.
#include <algorithm>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "denoise/denoiser_buffers.h"
#include "denoise/resample.h"
#include "denoise/signals.h"

namespace svgf {

void Denoiser::resize(int width, int height) {
    if (width == width_ && height == height_) return;
    // What a frame alone needs makes room first.
    for (Memory* memory : {&guides_, &working_, &scratch_, &next_history_, &moments_}) *memory = {};
    if (has_history_) {
        with_method([&]<class Method>() {
            using Storage = typename Method::Storage;
            signals_ == 1 ? resample<Storage, 1>(width, height) : resample<Storage, 2>(width, height);
        });
        return;
    }
    for (Memory* memory : {&previous_guides_, &history_, &previous_moments_, &resolved_}) *memory = {};
    width_ = width;
    height_ = height;
    prepare(std::max(signals_, 1));
}

// Where the history is, at the size that it has.
template <class Storage, int Signals>
HistoryImages<Storage, Signals> Denoiser::history_views() {
    HistoryImages<Storage, Signals> views;
    views.guides = guides_of<Storage>(previous_guides_);
    for (int s = 0; s < Signals; ++s) {
        views.color[s] = color_of<Storage>(Place::history, s);
        views.moments[s] = moments_of<Storage>(previous_moments_, s);
    }
    if (has_resolved_) views.resolved = {resolved_.data()};
    return views;
}

template <class Storage, int Signals>
void Denoiser::resample(int width, int height) {
    Resample<Storage, Signals> stage;
    stage.in = history_views<Storage, Signals>();
    stage.frames_share = std::min(1.0f, float(pixels()) / (float(width) * float(height)));
    Memory old[] = {std::move(previous_guides_), std::move(history_), std::move(previous_moments_),
                    std::move(resolved_)};
    has_history_ = false;  // until all of it is there
    width_ = width;
    height_ = height;
    prepare(Signals);
    stage.out = history_views<Storage, Signals>();
    launch("resample", stage);
    has_history_ = true;
}

HostImages Denoiser::history_images() {
    HostImages result;
    if (!has_history_) return result;
    with_method([&]<class Method>() {
        using Storage = typename Method::Storage;
        const std::vector<std::byte> colors = history_.download(), moments = previous_moments_.download();
        for (int s = 0; s < signals_; ++s) {
            const typename Storage::Color color{const_cast<std::byte*>(&colors[s * pixels() * Storage::color_bytes])};
            HostImage& mean = result[std::string("color") + signal_suffix[s]] = {3, {}};
            for (size_t i = 0; i < pixels(); ++i) {
                const Vec4 c = color[int(i)];
                mean.values.insert(mean.values.end(), {c.x, c.y, c.z});
            }
            if constexpr (std::is_same_v<Method, Plus>) {
                const typename Storage::Moments known{
                    const_cast<std::byte*>(&moments[s * pixels() * Storage::moments_bytes])};
                HostImage& frames = result[std::string("frames") + signal_suffix[s]] = {1, {}};
                for (size_t i = 0; i < pixels(); ++i) frames.values.push_back(known[int(i)].x);
            }
        }
    });
    return result;
}

}  // namespace svgf
