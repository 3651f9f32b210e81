// SPDX-License-Identifier: Apache-2.0
// The signals that can be denoised, by their public names.
#pragma once

#include "denoise/denoiser.h"

namespace svgf {

// A signal, and the albedos whose sum it is divided by.
struct SignalInfo {
    const char* name;
    const char* albedo[2];
    bool is_specular = false, has_reflections = true;
};
inline constexpr SignalInfo signal_table[] = {
    {"diffuse", {"diffuse_albedo", nullptr}, false, false},
    {"specular", {"specular_albedo", nullptr}, true},
    {"direct", {"diffuse_albedo", "specular_albedo"}},
    {"indirect", {"diffuse_albedo", "specular_albedo"}},
    {"color", {"albedo", nullptr}},
};

// What is one image per signal ends in these: color0, color1.
inline constexpr const char* signal_suffix[max_signals] = {"0", "1"};

}  // namespace svgf
