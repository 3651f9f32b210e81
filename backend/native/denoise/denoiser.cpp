// SPDX-License-Identifier: Apache-2.0
// The frame: the order of the stages, and what each of them is given. Where the images lie is in denoiser_buffers.h,
// what goes on from frame to frame in denoiser_history.cpp.
#include "denoise/denoiser.h"

#include <type_traits>

#include "denoise/antialias.h"
#include "denoise/atrous.h"
#include "denoise/demodulate.h"
#include "denoise/denoiser_buffers.h"
#include "denoise/diagnose.h"
#include "denoise/modulate.h"
#include "denoise/signals.h"
#include "denoise/temporal.h"
#include "denoise/temporal_plus.h"
#include "denoise/variance.h"
#include "device/launch_shape.h"

namespace svgf {

namespace {

// Two stages in one launch, where the second reads no more of the first one's results than its own pixel.
template <class First, class Second>
struct Sequence {
    static constexpr LaunchShape launch_shape = {32, 4, 12};  // fastest on an H200

    First first;
    Second second;

    // What the second reads is still at hand.
    int bytes_per_pixel() const { return first.bytes_per_pixel() + second.bytes_per_pixel_after_demodulate(); }
    SVGF_HD void operator()(int x, int y) const {
        first(x, y);
        second(x, y);
    }
};
template <class First, class Second>
Sequence(First, Second) -> Sequence<First, Second>;

}  // namespace

std::optional<DenoiseMethod> denoise_method_from_name(std::string_view name) {
    if (name == "svgf+") return DenoiseMethod::svgf_plus;
    if (name == "svgf") return DenoiseMethod::svgf;
    if (name == "eaw") return DenoiseMethod::eaw;
    if (name == "none") return DenoiseMethod::none;
    return std::nullopt;
}

Denoiser::Denoiser(Device& device, int width, int height, DenoiseMethod method, const DenoiseSettings& settings)
    : device_(device), width_(width), height_(height), method_(method), settings_(settings) {
    repaired_ = Buffer<int>(device, 1, "repair counter");
    repaired_.clear();
    if (method == DenoiseMethod::svgf_plus) fireflies_ = Buffer<FireflyCount>(device, 1, "firefly counter");
    prepare(1);
}

void Denoiser::denoise(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, bool reset,
                       const DenoiseDiagnostics* diagnostics) {
    prepare(inputs.signals);
    diagnostics_ = diagnostics;
    if (diagnostics) device_.clear(diagnostics->suppressed_light, pixels() * sizeof(float));
    if (reset || inputs.signals != signals_) has_history_ = false;
    signals_ = inputs.signals;
    try {
        with_method([&]<class Method>() {
            signals_ == 1 ? run<Method, 1>(inputs, outputs) : run<Method, 2>(inputs, outputs);
        });
    } catch (...) {
        has_history_ = false;  // the memory holds half a frame
        diagnostics_ = nullptr;
        throw;
    }
    diagnostics_ = nullptr;
}

void Denoiser::add_traffic(const char* name, int bytes_per_pixel) {
    const size_t bytes = bytes_per_pixel * pixels();
    for (auto& [known, total] : traffic_)
        if (known == name) {
            total += bytes;
            return;
        }
    traffic_.emplace_back(name, bytes);
}

template <class Method, int Signals>
void Denoiser::run(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    using Storage = typename Method::Storage;
    traffic_.clear();
    repaired_.clear();
    if constexpr (std::is_same_v<Method, Plus>) {
        borrowed_working_[0] = reinterpret_cast<std::byte*>(outputs.color);
        borrowed_working_[1] = previous_guides_.data();
        borrowed_gradients_ = reinterpret_cast<std::byte*>(outputs.variance);
        run_plus<Signals>(inputs, outputs);
    } else {
        Place place = Place::working;
        const auto demodulate_stage = demodulate<Storage, Signals>(inputs);
        if (is_temporal()) {
            launch("demodulate+temporal", Sequence{demodulate_stage, temporal<Storage, Signals>(inputs)});
            if (diagnostics_) diagnose<Storage, Signals>(inputs);
            variance<Method, Signals>();
            for (int level = 0; level < levels(); ++level) {
                const Place next = level == 0 ? Place::history : level % 2 ? Place::scratch : Place::working;
                atrous<Method, Signals>(level, place, next);
                place = next;
            }
            if (levels() == 0)  // the means themselves are the history
                device_.copy(history_.data(), working_.data(), Signals * pixels() * Storage::color_bytes);
            launch("modulate", modulate<Storage, Signals>(inputs, outputs, place));
            moments_.swap(previous_moments_);
            guides_.swap(previous_guides_);
            has_history_ = true;
        } else {
            launch("demodulate", demodulate_stage);
            if (diagnostics_) diagnose<Storage, Signals>(inputs);
            for (int level = 0; level < levels(); ++level) {
                const Place next = place == Place::working ? Place::scratch : Place::working;
                edge_avoiding<Signals>(level, inputs.window, place, next);
                place = next;
            }
            launch("modulate", modulate<Storage, Signals>(inputs, outputs, place));
        }
    }
}

template <int Signals>
void Denoiser::run_plus(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    using Storage = Plus::Storage;
    temporal_plus<Signals>(inputs, outputs.history_length);
    if (diagnostics_) diagnose<Storage, Signals>(inputs);
    // The last level ends in scratch, as working lies in the image that the last stage writes.
    Place place = Place::history;
    for (int level = 0; level < levels(); ++level) {
        const Place next = (levels() - level) % 2 ? Place::scratch : Place::working;
        atrous<Plus, Signals>(level, place, next);
        place = next;
    }
    if (levels() == 0)
        device_.copy(next_history_.data(), history_.data(), Signals * pixels() * Storage::color_bytes);
    auto modulate_stage = modulate<Storage, Signals>(inputs, outputs, Place::scratch);
    for (int s = 0; s < Signals; ++s) modulate_stage.out_filtered_light[s] = color_of<Storage>(Place::history, s);
    modulate_stage.out_history_length = nullptr;
    const bool antialiases = settings_.antialias_frames > 1.0f;
    if (antialiases)
        antialias(inputs, modulate_stage);
    else
        launch("modulate", modulate_stage);
    has_resolved_ = antialiases;
    moments_.swap(previous_moments_);
    guides_.swap(previous_guides_);
    has_history_ = true;
}

template <int Signals>
NoisyFrame<Signals> Denoiser::noisy_frame(const DenoiseInputs& inputs) const {
    NoisyFrame<Signals> frame;
    frame.width = width_;
    frame.height = height_;
    for (int s = 0; s < Signals; ++s) {
        frame.in_signal[s] = inputs.signal[s];
        frame.in_albedo[s] = {{inputs.albedo[s][0], inputs.albedo[s][1]}};
    }
    frame.in_normal = inputs.normal;
    frame.in_depth = inputs.depth;
    frame.in_depth_gradient = inputs.depth_gradient;
    frame.in_object_id = inputs.object_id;
    if (method_ != DenoiseMethod::svgf_plus) return frame;
    if (!settings_.has(PlusStep::plane_slope)) frame.in_depth_gradient = nullptr;
    if (inputs.is_specular[Signals - 1] && settings_.has(PlusStep::gloss)) frame.in_roughness = inputs.roughness;
    return frame;
}

// The frame's guides; illumination in working.
template <class Storage, int Signals>
Demodulate<Storage, Signals> Denoiser::demodulate(const DenoiseInputs& inputs) {
    Demodulate<Storage, Signals> stage;
    stage.frame = noisy_frame<Signals>(inputs);
    stage.out_guides = guides_of<Storage>(guides_);
    stage.out_gradients = gradients<Storage>();
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) stage.out_illumination[s] = color_of<Storage>(Place::working, s);
    return stage;
}

template <class Storage>
Reprojection<Storage> Denoiser::reprojection(const DenoiseInputs& inputs) {
    Reprojection<Storage> result;
    if (has_history_) result.prev_guides = guides_of<Storage>(previous_guides_);
    result.in_motion = inputs.motion;
    result.motion_channels = inputs.motion_channels;
    result.depth_tolerance = settings_.depth_tolerance;
    result.normal_tolerance = settings_.normal_tolerance;
    return result;
}

// In place: working becomes the mean with its variance over time, and no other pixel reads it.
template <class Storage, int Signals>
Temporal<Storage, Signals> Denoiser::temporal(const DenoiseInputs& inputs) {
    Temporal<Storage, Signals> stage;
    stage.guides = guides_of<Storage>(guides_);
    stage.gradients = gradients<Storage>();
    stage.reprojection = reprojection<Storage>(inputs);
    stage.alpha = settings_.alpha;
    stage.alpha_moments = settings_.alpha_moments;
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_illumination[s] = stage.out_color[s] = color_of<Storage>(Place::working, s);
        stage.hist_color[s] = color_of<Storage>(Place::history, s);
        stage.hist_moments[s] = moments_of<Storage>(previous_moments_, s);
        stage.out_moments[s] = moments_of<Storage>(moments_, s);
    }
    return stage;
}

// From the inputs and history to the guides and the next history, which then takes history's place; that of the frame
// before becomes scratch.
template <int Signals>
void Denoiser::temporal_plus(const DenoiseInputs& inputs, float* history_length) {
    using Storage = Plus::Storage;
    fireflies_.clear();
    TemporalPlus<Storage, Signals> stage;
    stage.image_width = width_;
    stage.image_height = height_;
    stage.frame = noisy_frame<Signals>(inputs);
    stage.reprojection = reprojection<Storage>(inputs);
    if (!settings_.has(PlusStep::history)) stage.reprojection.prev_guides = {};
    stage.reprojection.tests_taps = settings_.has(PlusStep::tested_taps);
    stage.reprojection.interpolates = settings_.has(PlusStep::interpolation);
    stage.has_mean_drift = settings_.has(PlusStep::mean_drift);
    stage.has_catmull_rom = settings_.has(PlusStep::catmull_rom);
    stage.out_guides = guides_of<Storage>(guides_);
    stage.out_gradients = gradients<Storage>();
    stage.out_history_length = history_length;
    stage.history_frames = settings_.longest_history();
    stage.firefly_limit = settings_.firefly_limit;
    stage.history_fix_radius = settings_.history_fix_radius;
    stage.young_frames = settings_.has(PlusStep::local_mean) ? local_mean_frames : 0.0f;
    const bool tells_structure = settings_.has(PlusStep::structure);
    stage.structure_share = tells_structure ? noise_structure_share : 1.0f;
    stage.neighbours_share = tells_structure ? neighbours_variance_share : 1.0f;
    constexpr float never = 1e6f;
    stage.is_unchanged = inputs.is_unchanged;
    stage.out_repaired = repaired_.data();
    stage.out_fireflies = fireflies_.data();
    stage.out_suppressed_light = diagnostics_ ? diagnostics_->suppressed_light : nullptr;
    for (int s = 0; s < Signals; ++s) {
        const float sharper = inputs.is_specular[s] ? 1.0f / settings_.specular_sharpness : 1.0f;
        stage.is_specular[s] = inputs.is_specular[s];
        stage.has_reflections[s] = has_reflections_[s] = inputs.has_reflections[s];
        all_sharp_ = (s == 0 || all_sharp_) && inputs.has_reflections[s] && !stage.frame.in_roughness;
        stage.history_clamp[s] = inputs.is_unchanged     ? never
                                 : inputs.is_specular[s] ? settings_.specular_history_clamp
                                                         : settings_.history_clamp;
        stage.change_threshold[s] = inputs.is_unchanged     ? never
                                    : inputs.is_specular[s] ? settings_.specular_change_threshold
                                                            : settings_.change_threshold;
        stage.variance_scale[s] = square(sharper);
        stage.hist_color[s] = color_of<Storage>(Place::history, s);
        stage.hist_moments[s] = moments_of<Storage>(previous_moments_, s);
        stage.out_color[s] = color_of<Storage>(Place::scratch, s);
        stage.out_moments[s] = moments_of<Storage>(moments_, s);
    }
    launch_tiles("demodulate+temporal", stage);
    history_.swap(next_history_);
}

// From scratch to the caller's image and, in place of the guides of the frame before, the next resolved colour.
template <int Signals>
void Denoiser::antialias(const DenoiseInputs& inputs, const Modulate<PackedStorage, Signals>& modulate) {
    using Storage = PackedStorage;
    Antialias<Storage, Signals> stage;
    stage.image_width = width_;
    stage.image_height = height_;
    stage.frame = noisy_frame<Signals>(inputs);
    stage.guides = guides_of<Storage>(guides_);
    stage.modulate = modulate;
    stage.hist_color = {resolved_.data()};
    stage.has_history = has_history_ && has_resolved_;
    stage.is_unchanged = inputs.is_unchanged;
    stage.is_interactive = inputs.is_interactive;
    stage.in_motion = inputs.motion;
    stage.motion_channels = inputs.motion_channels;
    for (int s = 0; s < Signals; ++s) stage.in_moments[s] = moments_of<Storage>(moments_, s);
    stage.in_emission = inputs.emission;
    stage.antialias_frames = settings_.antialias_frames;
    stage.still_frames = settings_.has(PlusStep::hand_over) ? hand_over_frames : largest_float;
    stage.is_catmull_rom = settings_.has(PlusStep::catmull_rom);
    stage.out_history = {previous_guides_.data()};
    stage.out_color = modulate.out_color;
    launch_tiles("modulate+antialias", stage);
    resolved_.swap(previous_guides_);
}

// In place: only the variance of working changes, and no other pixel reads it.
template <class Method, int Signals>
void Denoiser::variance() {
    using Storage = typename Method::Storage;
    Variance<Method, Signals> stage;
    stage.guides = guides_of<Storage>(guides_);
    stage.gradients = gradients<Storage>();
    stage.sigma_depth = settings_.sigma_depth;
    stage.sigma_normal = settings_.sigma_normal;
    stage.spatial_variance_frames = settings_.spatial_variance_frames;
    for (int s = 0; s < Signals; ++s) {
        stage.in_moments[s] = moments_of<Storage>(moments_, s);
        stage.out_color[s] = color_of<Storage>(Place::working, s);
    }
    launch("variance", stage);
}

template <class Method, int Signals, class Sink>
void Denoiser::atrous(const char* name, int level, Place from, const Sink& sink) {
    using Storage = typename Method::Storage;
    const auto launch = [&]<class Filter, int PhasesLog2>() {
        Atrous<Filter, Signals, PhasesLog2, Sink> stage;
        stage.guides = guides_of<Storage>(guides_);
        stage.gradients = gradients<Storage>();
        stage.lattice = {level, width_, height_};
        constexpr bool plus = std::is_same_v<Method, Plus>;
        stage.sigma_depth = plus ? settings_.plus_sigma_depth : settings_.sigma_depth;
        stage.sigma_normal = plus ? settings_.plus_sigma_normal : settings_.sigma_normal;
        stage.sigma_luminance = plus ? settings_.plus_sigma_luminance : settings_.sigma_luminance;
        stage.has_prefilter = settings_.has(PlusStep::prefilter);
        for (int s = 0; s < Signals; ++s) {
            stage.in_color[s] = color_of<Storage>(from, s);
            stage.has_reflections[s] = has_reflections_[s];
        }
        stage.sink = sink;
        launch_tiles(name, stage);
    };
    const auto launch_level = [&]<class Filter>() {
        static_assert(most_phases_log2 == 2);
        if (level == 0) launch.template operator()<Filter, 0>();
        else if (level == 1) launch.template operator()<Filter, 1>();
        else launch.template operator()<Filter, 2>();
    };
    if constexpr (std::is_same_v<Method, Plus>)
        if (all_sharp_ || !settings_.has(PlusStep::both_variances))
            return launch_level.template operator()<SharpPlus>();
    launch_level.template operator()<Method>();
}

template <class Method, int Signals>
void Denoiser::atrous(int level, Place from, Place to) {
    using Storage = typename Method::Storage;
    StoreColor<Storage, Signals> sink;
    for (int s = 0; s < Signals; ++s) sink.out_color[s] = color_of<Storage>(to, s);
    atrous<Method, Signals>("atrous", level, from, sink);
}

template <int Signals>
void Denoiser::edge_avoiding(int level, const Vec4& window, Place from, Place to) {
    EdgeAvoiding<Signals> stage;
    stage.guides = guides_of<FloatStorage>(guides_);
    stage.level = level;
    stage.window = window;
    stage.sigma_color = settings_.eaw_sigma_color;
    stage.sigma_normal = settings_.eaw_sigma_normal;
    stage.sigma_position = settings_.eaw_sigma_position;
    for (int s = 0; s < Signals; ++s) {
        stage.in_color[s] = color_of<FloatStorage>(from, s);
        stage.out_color[s] = color_of<FloatStorage>(to, s);
    }
    launch("atrous", stage);
}

template <class Storage, int Signals>
Modulate<Storage, Signals> Denoiser::modulate(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, Place from) {
    Modulate<Storage, Signals> stage;
    stage.in_emission = inputs.emission;
    stage.guides = guides_of<Storage>(guides_);
    stage.has_length = is_temporal();
    stage.out_color = outputs.color;
    stage.out_variance = outputs.variance;
    stage.out_history_length = outputs.history_length;
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_color[s] = color_of<Storage>(from, s);
        stage.in_albedo[s] = {{inputs.albedo[s][0], inputs.albedo[s][1]}};
    }
    return stage;
}

// After temporal, before the guides of the frame before are overwritten.
template <class Storage, int Signals>
void Denoiser::diagnose(const DenoiseInputs& inputs) {
    Diagnose<Storage, Signals> stage;
    stage.frame = noisy_frame<Signals>(inputs);
    stage.in_emission = inputs.emission;
    stage.guides = guides_of<Storage>(guides_);
    stage.gradients = gradients<Storage>();
    if (is_temporal()) stage.reprojection = reprojection<Storage>(inputs);
    for (int s = 0; s < Signals; ++s) stage.in_moments[s] = moments_of<Storage>(moments_, s);
    stage.pixel_size = (inputs.window.y - inputs.window.x) / float(width_);
    stage.out_motion_error = diagnostics_->motion_error;
    stage.out_reset_reason = diagnostics_->reset_reason;
    stage.out_repaired_values = diagnostics_->repaired_values;
    launch("diagnose", stage);
}

int Denoiser::repaired() const { return repaired_.download()[0]; }

FireflyCount Denoiser::fireflies() const { return fireflies_ ? fireflies_.download()[0] : FireflyCount{}; }

}  // namespace svgf

#include "denoise/run_stage.h"
