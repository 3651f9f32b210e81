// SPDX-License-Identifier: Apache-2.0
// What a user may set about the denoiser, declared once: SVGF_DENOISE_SETTINGS makes the struct, its defaults and the
// table that the bindings list. svgf/settings.py mirrors the table and tests/test_settings.py holds the two together.
#pragma once

#include <string_view>

namespace svgf {

// SETTING(name, type, default, minimum, maximum, unit, symbol, meaning), ranges inclusive, symbol as in the paper:
// [Schied17] but for eaw_*, which are [Dammertz10]'s. Unless another method is named, settings are svgf's; svgf+ shares
// levels and the tolerances.
#define SVGF_DENOISE_SETTINGS(SETTING)                                                                                 \
    SETTING(alpha, float, 0.2, 0.0, 1.0, "", "alpha",                                                                  \
            "Least weight of the new frame in the temporal mean of colour; 0 keeps the plain mean of all frames.")     \
    SETTING(alpha_moments, float, 0.2, 0.0, 1.0, "", "alpha",                                                          \
            "Least weight of the new frame in the temporal moments of luminance.")                                     \
    SETTING(sigma_depth, float, 1.0, 0.0, 1e6, "", "sigma_z",                                                          \
            "Depth differences that the depth gradient does not explain: larger blurs across them.")                   \
    SETTING(sigma_normal, float, 128.0, 1e-3, 1e6, "", "sigma_n",                                                      \
            "Exponent of the cosine between normals: smaller blurs across creases.")                                   \
    SETTING(sigma_luminance, float, 4.0, 0.0, 1e6, "standard deviations", "sigma_l",                                   \
            "Luminance differences that count as noise: larger blurs more.")                                           \
    SETTING(levels, int, 5, 0, 8, "", "i",                                                                             \
            "Levels of the a-trous wavelet transform; level i has taps 2^i pixels apart.")                             \
    SETTING(spatial_variance_frames, int, 4, 1, 64, "frames", "",                                                      \
            "Variance is estimated over 7x7 pixels while history is shorter than this.")                               \
    SETTING(depth_tolerance, float, 0.02, 0.0, 1.0, "share of depth", "",                                              \
            "Reprojection accepts history whose plane misses the expected depth by at most this.")                     \
    SETTING(normal_tolerance, float, 0.9, -1.0, 1.0, "cosine", "",                                                     \
            "Reprojection accepts history whose normal has at least this cosine with the new one.")                    \
    SETTING(history_frames, float, 20.0, 1.0, 4096.0, "frames", "",                                                    \
            "svgf+: longest history where something moves; what stands still has no limit.")                           \
    SETTING(history_seconds, float, 0.0, 0.0, 3600.0, "s", "",                                                         \
            "svgf+: the same in seconds, so that lag is the same at any frame_rate. 0: history_frames counts.")        \
    SETTING(frame_rate, float, 24.0, 0.01, 1e5, "frames/s", "",                                                        \
            "svgf+: frames in a second of the sequence, or of a view as it is drawn, for history_seconds.")            \
    SETTING(history_clamp, float, 3.0, 0.0, 1e6, "standard deviations", "",                                            \
            "svgf+: how far history may be from the 3x3 new samples before it is drawn to them. 1e6: however far.")    \
    SETTING(specular_history_clamp, float, 0.4, 0.0, 1e6, "standard deviations", "",                                   \
            "svgf+: the same of the specular signal, which moves otherwise than its surface.")                         \
    SETTING(change_threshold, float, 0.2, 1e-3, 1e6, "standard deviations", "",                                        \
            "svgf+: samples this far from history, over a few frames and pixels, are a change. 1e6: nothing is.")      \
    SETTING(specular_change_threshold, float, 0.3, 1e-3, 1e6, "standard deviations", "",                               \
            "svgf+: the same of the specular signal, whose deviation leaves out what looks like structure.")           \
    SETTING(history_fix_radius, int, 16, 1, 256, "pixels", "",                                                         \
            "svgf+: how far around what has just appeared its surface is looked for a frame ago. 1: beside it.")       \
    SETTING(firefly_limit, float, 60.0, 1.0, 1e9, "", "",                                                              \
            "svgf+: brightest sample, over what history and neighbours say; what is above is cut. 1e9: nothing.")      \
    SETTING(specular_sharpness, float, 1.4, 1.0, 1e3, "", "",                                                          \
            "svgf+: the specular signal is filtered as if sigma_luminance were smaller by this.")                      \
    SETTING(plus_sigma_luminance, float, 4.5, 0.0, 1e6, "standard deviations of the mean", "sigma_l",                  \
            "svgf+: luminance differences that count as noise; larger blurs more.")                                    \
    SETTING(plus_sigma_depth, float, 3.0, 0.0, 1e6, "", "sigma_z",                                                     \
            "svgf+: depth differences that the depth gradient does not explain: larger blurs across them.")            \
    SETTING(plus_sigma_normal, float, 20.0, 1e-3, 1e6, "", "sigma_n",                                                  \
            "svgf+: sharpness of the lobe around the normal; smaller blurs across creases.")                           \
    SETTING(antialias_frames, float, 4.0, 1.0, 1024.0, "frames", "",                                                   \
            "svgf+: frames over which the picture is resolved where something moves. 1: not at all.")                  \
    SETTING(steps, int, 4095, 0, 4095, "", "",                                                                         \
            "svgf+: a bit for each step that no other setting switches off, to measure what it gives; see PlusStep.")  \
    SETTING(eaw_sigma_color, float, 4.0, 1e-6, 1e6, "demodulated radiance", "sigma_rt",                                \
            "Colour differences that count as noise at level 0; halved at each level.")                                \
    SETTING(eaw_sigma_normal, float, 0.3, 1e-6, 1e6, "", "sigma_n",                                                    \
            "Distance between normals, over the tap spacing, that the filter crosses.")                                \
    SETTING(eaw_sigma_position, float, 0.3, 1e-6, 1e6, "m", "sigma_x",                                                 \
            "Distance between world positions that the filter crosses.")

// Bits of `steps`. They are looked at before a launch, or by a branch that all pixels take alike.
enum class PlusStep : int {
    local_mean = 1,       // diffuse light begins with the mean of the 3x3 samples
    structure = 2,        // what looks like structure, among the samples or in history, is no noise
    both_variances = 4,   // Eq. 5 over the larger variance of both pixels
    gloss = 8,            // rough reflections are filtered as diffuse light
    hand_over = 16,       // what stands still goes over to the mean of the noisy frames
    history = 32,         // frames are averaged over time
    tested_taps = 64,     // history is read where it saw the same surface, else wherever it was
    interpolation = 128,  // history is read between four pixels, else from the nearest
    plane_slope = 256,    // depth gradients are those of the surface's plane, else differences of depth
    mean_drift = 512,     // changes of light are told by the mean of the 3x3 samples, else by the pixel's own
    prefilter = 1024,     // the variance is prefiltered at the first level
    catmull_rom = 2048    // how history and the resolved picture are read where something moves, else bilinear
};

struct DenoiseSettings {
#define SVGF_MEMBER(name, type, fallback, minimum, maximum, unit, symbol, meaning) type name = type(fallback);
    SVGF_DENOISE_SETTINGS(SVGF_MEMBER)
#undef SVGF_MEMBER

    bool operator==(const DenoiseSettings&) const = default;

    bool has(PlusStep step) const { return (steps & int(step)) != 0; }

    // svgf+: in frames, where something moves.
    float longest_history() const {
        if (history_seconds <= 0.0f) return history_frames;
        const float frames = history_seconds * frame_rate;
        return frames < 1.0f ? 1.0f : frames > 4096.0f ? 4096.0f : frames;
    }
};

struct SettingInfo {
    std::string_view name, type;
    double fallback, minimum, maximum;  // fallback: the default
    std::string_view unit, symbol, meaning;
};

inline constexpr SettingInfo denoise_setting_table[] = {
#define SVGF_ROW(name, type, fallback, minimum, maximum, unit, symbol, meaning)                                        \
    {#name, #type, fallback, minimum, maximum, unit, symbol, meaning},
    SVGF_DENOISE_SETTINGS(SVGF_ROW)
#undef SVGF_ROW
};

// False if there is no such setting or the value is outside its range (NaN is).
inline bool set_denoise_setting(DenoiseSettings& settings, std::string_view name_to_set, double value) {
#define SVGF_SET(name, type, fallback, minimum, maximum, unit, symbol, meaning)                                        \
    if (name_to_set == #name) {                                                                                        \
        if (!(value >= minimum && value <= maximum)) return false;                                                     \
        settings.name = static_cast<type>(value);                                                                      \
        return true;                                                                                                   \
    }
    SVGF_DENOISE_SETTINGS(SVGF_SET)
#undef SVGF_SET
    return false;
}

}  // namespace svgf
