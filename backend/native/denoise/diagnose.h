// SPDX-License-Identifier: Apache-2.0
// Stage "diagnose": what a frame can tell beside its result, for whoever asks. Runs between temporal and the filter,
// while the guides of the frame before are there; the other stages know nothing of it, and without it cost what they
// cost. Looks for history by the same code as temporal does.
#pragma once

#include "denoise/demodulate.h"
#include "denoise/denoiser.h"
#include "denoise/reprojection.h"

namespace svgf {

template <class Storage, int Signals>
struct Diagnose {
    NoisyFrame<Signals> frame;
    const float* in_emission;
    typename Storage::Guides guides;
    typename Storage::Gradients gradients;
    Reprojection<Storage> reprojection;            // without prev_guides: no history
    typename Storage::Moments in_moments[Signals];  // svgf+: of this frame; else null
    float pixel_size;                              // width of a pixel on the plane one unit ahead
    float* out_motion_error;                       // [H, W] each
    float* out_reset_reason;
    float* out_repaired_values;

    int bytes_per_pixel() const {
        return frame.bytes_per_pixel() + reprojection.bytes_per_pixel() + Storage::guide_bytes +
               Storage::gradient_bytes + 12;
    }

    SVGF_HD void operator()(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        int repaired = count_repairs(x, y);
        float error = 0.0f;
        const ResetReason reason = find_reason(x, y, error, repaired);
        out_motion_error[pixel] = error;
        out_reset_reason[pixel] = float(int(reason));
        out_repaired_values[pixel] = float(repaired);
    }

private:
    SVGF_HD int count_repairs(int x, int y) const {
        const int pixel = guides.pixel(x, y);
        int repaired = 0;
        for (int s = 0; s < Signals; ++s) frame.illumination(s, pixel, repaired);
        int32_t id;
        frame.surface(x, y, id, repaired);
        if (id != 0) {
            frame.gradient(x, y, id, repaired);
            frame.gloss(pixel, repaired);
        }
        if (in_emission) repair(load3(in_emission, pixel), repaired);
        return repaired;
    }

    SVGF_HD ResetReason find_reason(int x, int y, float& error, int& repaired) const {
        const int pixel = guides.pixel(x, y);
        const Vec4 surface = guides.normal_depth(pixel);
        if (!is_surface(surface.w)) return ResetReason::background;
        if (!reprojection.prev_guides) return ResetReason::restarted;
        const int repaired_before = repaired;
        const Vec2 slope = gradients[pixel];
        typename Reprojection<Storage>::Point point;
        if (!reprojection.find(x, y, surface, slope, guides.object_id(pixel), point, repaired))
            return repaired > repaired_before ? ResetReason::bad_motion : ResetReason::outside;

        const int column = int(std::floor(point.x + 0.5f)), row = int(std::floor(point.y + 0.5f));
        ResetReason refusal = ResetReason::outside;
        if (guides.contains(column, row)) {
            const auto there = reprojection.compare(column, row, point);
            const float footprint = std::fabs(slope.x) + std::fabs(slope.y) + surface.w * pixel_size + 1e-30f;
            if (there.same_object) error = std::fabs(there.depth_error) / footprint;
            refusal = !there.same_object                               ? ResetReason::other_object
                      : std::fabs(there.depth_error) > point.tolerance ? ResetReason::other_depth
                                                                       : ResetReason::other_normal;
        }
        bool found = false;
        reprojection.visit(point, reprojection.weigh(point),
                           [&](int, float weight) { found = found || weight > 0.0f; });
        if (!found) return refusal;
        return has_changed(pixel) ? ResetReason::light_changed : ResetReason::kept;
    }

    SVGF_HD bool has_changed(int pixel) const {
        bool changed = false;
        if constexpr (!Storage::holds_any_bits)
            for (int s = 0; s < Signals; ++s) changed = changed || in_moments[s].has_changed(pixel);
        return changed;
    }
};

}  // namespace svgf
