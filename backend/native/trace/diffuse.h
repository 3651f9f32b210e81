// SPDX-License-Identifier: Apache-2.0
// Diffuse reflection: Lambert's, or the improved Oren-Nayar model [Fujii12] with an energy-preserving term, whose
// strength is that of Cycles: it holds one factor of the colour more than [Portsmouth25, Eq. 20].
#pragma once

#include "core/approximate.h"
#include "core/vec.h"

namespace svgf {

struct OrenNayar {
    float a = 1 / pi, b = 0;
    Vec3 multiple;         // factor of multiple scattering, without the term of the light
    Vec3 albedo{1, 1, 1};  // towards the viewer, over the lobe's weight

    // Below this roughness a surface is Lambert's.
    static constexpr float smallest_roughness = 1e-5f;

    OrenNayar() = default;
    SVGF_HD OrenNayar(float roughness, float cos_view, Vec3 color) {
        if (roughness < smallest_roughness) return;
        a = fast_reciprocal(pi + roughness * (pi / 2.0f - 2.0f / 3.0f));
        b = roughness * a;
        const float mean = a * pi + ((2.0f * pi - 5.6f) / 3.0f) * b, rest = 1.0f - mean;
        const float view = a * pi + b * loss(cos_view);
        const Vec3 left = 1.0f - color * rest;
        multiple = color * color * Vec3{fast_reciprocal(left.x), fast_reciprocal(left.y), fast_reciprocal(left.z)} *
                   (fast_quotient(mean, rest) * (1.0f - view) * (1.0f / pi));
        albedo = multiple * (pi * rest) + view;
    }

    // Over the lobe's weight, without the cosine. cos_between: of the angle between view and light.
    SVGF_HD Vec3 evaluate(float cos_view, float cos_light, float cos_between) const {
        if (!(b > 0.0f)) return {a, a, a};
        float t = cos_between - cos_light * max(cos_view, 0.0f);
        if (t > 0.0f) t = fast_quotient(t, max(max(cos_light, cos_view), 1e-30f));
        return multiple * (1.0f - (a * pi + b * loss(cos_light))) + (a + b * t);
    }

private:
    // G, with which the directional albedo is a pi + b G.
    SVGF_HD static float loss(float cosine) {
        const float c = saturate(cosine);
        if (c < 1e-6f) return pi / 2.0f - 2.0f / 3.0f - c;
        const float s = fast_sqrt(1.0f - c * c);
        return s * (std::acos(c) - 2.0f / 3.0f - s * c) + 2.0f / 3.0f * fast_quotient(s, c) * (1.0f - s * s * s);
    }
};

}  // namespace svgf
