// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <algorithm>
#include <type_traits>
#include <utility>

#include "denoise/antialias.h"
#include "denoise/atrous.h"
#include "denoise/demodulate.h"
#include "denoise/modulate.h"
#include "denoise/temporal.h"
#include "denoise/temporal_plus.h"
#include "denoise/variance.h"
#include "device/launch_shape.h"

namespace svgf {

namespace {

// Every signal that can be denoised, and the albedos whose sum it is divided by.
struct SignalInfo {
    const char* name;
    const char* albedo[2];
    bool is_specular = false;
};
constexpr SignalInfo signal_table[] = {
    {"diffuse", {"diffuse_albedo", nullptr}},
    {"specular", {"specular_albedo", nullptr}, true},
    {"direct", {"diffuse_albedo", "specular_albedo"}},
    {"indirect", {"diffuse_albedo", "specular_albedo"}},
    {"color", {"albedo", nullptr}},
};

const char* const signal_suffix[max_signals] = {"0", "1"};

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

DenoiseInputs gather_denoise_inputs(const std::function<ImageView(const char* name)>& image) {
    DenoiseInputs inputs;
    const auto floats = [&](const char* name) { return static_cast<const float*>(image(name).data); };
    for (const SignalInfo& info : signal_table) {
        const float* signal = floats(info.name);
        if (!signal) continue;
        if (inputs.signals == max_signals) throw InputError("More than two signals are given.");
        inputs.signal[inputs.signals] = signal;
        inputs.is_specular[inputs.signals] = info.is_specular;
        for (int i = 0; i < 2; ++i)
            if (info.albedo[i]) inputs.albedo[inputs.signals][i] = floats(info.albedo[i]);
        ++inputs.signals;
    }
    if (inputs.signals == 0) throw InputError("No signal is given: diffuse, specular, direct, indirect or color.");
    inputs.emission = floats("emission");
    inputs.normal = floats("normal");
    inputs.depth = floats("depth");
    inputs.depth_gradient = floats("depth_gradient");
    const ImageView motion = image("motion");
    inputs.motion = static_cast<const float*>(motion.data);
    inputs.motion_channels = motion.channels;
    inputs.object_id = static_cast<const int32_t*>(image("object_id").data);
    if (!inputs.normal || !inputs.depth) throw InputError("The images normal and depth are needed.");
    return inputs;
}

// run.operator()<Method>() for the traits of the denoiser's method.
template <class Run>
auto Denoiser::with_method(Run run) {
    return method_ == DenoiseMethod::svgf_plus ? run.template operator()<Plus>() : run.template operator()<Published>();
}

Denoiser::Denoiser(Device& device, int width, int height, DenoiseMethod method, const DenoiseSettings& settings)
    : device_(device), width_(width), height_(height), method_(method), settings_(settings) {
    repaired_ = Buffer<int>(device, 1, "repair counter");
    repaired_.clear();
    if (method == DenoiseMethod::svgf_plus) fireflies_ = Buffer<FireflyCount>(device, 1, "firefly counter");
    prepare(1);
}

void Denoiser::prepare(int signals) {
    with_method([&]<class Method>() { allocate<typename Method::Storage>(signals); });
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
    need(guides_, Storage::guide_bytes, "guides");
    if (method_ != DenoiseMethod::svgf_plus) need(working_, color_bytes, "working colour");
    if (!is_temporal()) {
        if (method_ != DenoiseMethod::none) need(scratch_, color_bytes, "scratch colour");
        return;
    }
    static_assert(max_signals * Storage::color_bytes <= Storage::guide_bytes);  // scratch
    need(previous_guides_, Storage::guide_bytes, "previous guides");
    need(history_, color_bytes, "history");
    need(moments_, signals * Storage::moments_bytes, "moments");
    need(previous_moments_, signals * Storage::moments_bytes, "previous moments");
    if (method_ != DenoiseMethod::svgf_plus) return;
    need(next_history_, color_bytes, "next history");
    need(resolved_, Storage::color_bytes, "resolved colour");
    need(previous_resolved_, Storage::color_bytes, "previous resolved colour");
}

template <class Storage>
typename Storage::Guides Denoiser::guides_of(Memory& memory) {
    return {memory.data(), width_, height_};
}

template <class Storage>
typename Storage::Color Denoiser::color_of(Place place, int signal) {
    if (place == Place::working && borrowed_[signal]) return {borrowed_[signal]};
    Memory& memory = place == Place::working   ? working_
                     : place == Place::history ? history_
                     : place == Place::spare   ? next_history_
                     : is_temporal()           ? previous_guides_
                                               : scratch_;
    return {memory.data() + signal * pixels() * Storage::color_bytes};
}

template <class Storage>
typename Storage::Moments Denoiser::moments_of(Memory& memory, int signal) {
    return {memory.data() + signal * pixels() * Storage::moments_bytes};
}

void Denoiser::denoise(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, bool reset) {
    prepare(inputs.signals);
    if (reset || inputs.signals != signals_) has_history_ = false;
    signals_ = inputs.signals;
    try {
        with_method([&]<class Method>() {
            signals_ == 1 ? run<Method, 1>(inputs, outputs) : run<Method, 2>(inputs, outputs);
        });
    } catch (...) {
        has_history_ = false;  // the memory holds half a frame
        throw;
    }
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

template <class Method, int Signals>
void Denoiser::run(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    using Storage = typename Method::Storage;
    traffic_.clear();
    repaired_.clear();
    if constexpr (std::is_same_v<Method, Plus>) {
        borrowed_[0] = reinterpret_cast<std::byte*>(outputs.color);
        borrowed_[1] = resolved_.data();
        run_plus<Signals>(inputs, outputs);
    } else {
        for (std::byte*& memory : borrowed_) memory = nullptr;
        Place place = Place::working;
        const auto demodulate_stage = demodulate<Storage, Signals>(inputs);
        if (is_temporal()) {
            launch("demodulate and temporal", Sequence{demodulate_stage, temporal<Storage, Signals>(inputs)});
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
    launch("demodulate", demodulate<Storage, Signals>(inputs));
    temporal_plus<Signals>(inputs);
    Place place = Place::history;
    const int last = levels() - 1;
    // The last level writes into history and, without antialias, into working: it reads scratch.
    for (int level = 0; level < max(last, min(levels(), 1)); ++level) {
        const Place next = last == level || (last - level) % 2 ? Place::scratch : Place::working;
        atrous<Plus, Signals>(level, place, next);
        place = next;
    }
    auto modulate_stage = modulate<Storage, Signals>(inputs, outputs, place);
    for (int s = 0; s < Signals; ++s) modulate_stage.out_filtered_light[s] = color_of<Storage>(Place::history, s);
    const bool antialiases = settings_.antialias_frames > 1.0f;
    if (antialiases) {
        modulate_stage.out_color = nullptr;
        modulate_stage.out_unresolved = color_of<Storage>(Place::spare, 0);
    }
    if (last >= 1)
        atrous<Plus, Signals>("atrous and modulate", last, place, modulate_stage);
    else
        launch("modulate", modulate_stage);
    if (antialiases) antialias<Signals>(inputs, outputs);
    has_resolved_ = antialiases;
    moments_.swap(previous_moments_);
    guides_.swap(previous_guides_);
    has_history_ = true;
}

// The frame's guides; illumination in working.
template <class Storage, int Signals>
Demodulate<Storage, Signals> Denoiser::demodulate(const DenoiseInputs& inputs) {
    Demodulate<Storage, Signals> stage;
    stage.width = width_;
    stage.height = height_;
    stage.in_normal = inputs.normal;
    stage.in_depth = inputs.depth;
    stage.in_depth_gradient = inputs.depth_gradient;
    stage.in_object_id = inputs.object_id;
    stage.out_guides = guides_of<Storage>(guides_);
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_signal[s] = inputs.signal[s];
        for (int i = 0; i < 2; ++i) stage.in_albedo[s][i] = inputs.albedo[s][i];
        stage.out_illumination[s] = color_of<Storage>(Place::working, s);
    }
    return stage;
}

template <class Storage>
Reprojection<Storage> Denoiser::reprojection(const DenoiseInputs& inputs) {
    Reprojection<Storage> result;
    result.guides = guides_of<Storage>(guides_);
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

// From working and history to the next history, which then takes history's place; that of the frame before is spare.
template <int Signals>
void Denoiser::temporal_plus(const DenoiseInputs& inputs) {
    using Storage = Plus::Storage;
    fireflies_.clear();
    TemporalPlus<Storage, Signals> stage;
    stage.reprojection = reprojection<Storage>(inputs);
    stage.history_frames = settings_.history_frames;
    stage.firefly_limit = settings_.firefly_limit;
    stage.change_threshold = settings_.change_threshold;
    stage.out_repaired = repaired_.data();
    stage.out_fireflies = fireflies_.data();
    for (int s = 0; s < Signals; ++s) {
        const float sharper = inputs.is_specular[s] ? 1.0f / settings_.specular_sharpness : 1.0f;
        stage.history_clamp[s] = inputs.is_specular[s] ? settings_.specular_history_clamp : settings_.history_clamp;
        stage.variance_scale[s] = square(sharper);
        stage.in_illumination[s] = color_of<Storage>(Place::working, s);
        stage.hist_color[s] = color_of<Storage>(Place::history, s);
        stage.hist_moments[s] = moments_of<Storage>(previous_moments_, s);
        stage.out_color[s] = color_of<Storage>(Place::spare, s);
        stage.out_moments[s] = moments_of<Storage>(moments_, s);
    }
    launch("temporal", stage);
    history_.swap(next_history_);
}

template <int Signals>
void Denoiser::antialias(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    using Storage = Plus::Storage;
    Antialias<Storage, Signals> stage;
    stage.guides = guides_of<Storage>(guides_);
    stage.in_color = color_of<Storage>(Place::spare, 0);
    stage.hist_color = {previous_resolved_.data()};
    stage.has_history = has_history_ && has_resolved_;
    stage.in_motion = inputs.motion;
    stage.motion_channels = inputs.motion_channels;
    for (int s = 0; s < Signals; ++s) {
        stage.in_signal[s] = inputs.signal[s];
        for (int i = 0; i < 2; ++i) stage.in_albedo[s][i] = inputs.albedo[s][i];
        stage.in_moments[s] = moments_of<Storage>(moments_, s);
    }
    stage.in_emission = inputs.emission;
    stage.antialias_frames = settings_.antialias_frames;
    stage.out_history = {resolved_.data()};
    stage.out_color = outputs.color;
    launch("antialias", stage);
    resolved_.swap(previous_resolved_);
}

// In place: only the variance of working changes, and no other pixel reads it.
template <class Method, int Signals>
void Denoiser::variance() {
    using Storage = typename Method::Storage;
    Variance<Method, Signals> stage;
    stage.guides = guides_of<Storage>(guides_);
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
    const auto launch = [&]<int PhasesLog2>() {
        Atrous<Method, Signals, PhasesLog2, Sink> stage;
        stage.guides = guides_of<Storage>(guides_);
        stage.lattice = {level, width_, height_};
        stage.sigma_depth = settings_.sigma_depth;
        constexpr bool plus = std::is_same_v<Method, Plus>;
        stage.sigma_normal = plus ? settings_.plus_sigma_normal : settings_.sigma_normal;
        stage.sigma_luminance = plus ? settings_.plus_sigma_luminance : settings_.sigma_luminance;
        for (int s = 0; s < Signals; ++s) stage.in_color[s] = color_of<Storage>(from, s);
        stage.sink = sink;
        launch_tiles(name, stage);
    };
    static_assert(most_phases_log2 == 2);
    if (level == 0) launch.template operator()<0>();
    else if (level == 1) launch.template operator()<1>();
    else launch.template operator()<2>();
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
        for (int i = 0; i < 2; ++i) stage.in_albedo[s][i] = inputs.albedo[s][i];
    }
    return stage;
}

int Denoiser::repaired() const { return repaired_.download()[0]; }

FireflyCount Denoiser::fireflies() const { return fireflies_ ? fireflies_.download()[0] : FireflyCount{}; }

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
    add("previous resolved colour", previous_resolved_);
    add("repair counter", repaired_);
    return list;
}

// ---- Single stages, for tests ----

namespace {

const HostImage& find_image(const HostImages& images, const std::string& name, size_t pixels, int channels) {
    const auto found = images.find(name);
    if (found == images.end()) throw InputError("The stage needs the image " + name + ".");
    if (found->second.channels != channels || found->second.values.size() != pixels * channels)
        throw InputError("The image " + name + " needs the frame's size, " + std::to_string(channels) + " channels.");
    return found->second;
}

template <class T>
std::vector<T> upload_values(const HostImage& image) {
    return std::vector<T>(image.values.begin(), image.values.end());
}

}  // namespace

HostImages Denoiser::run_stage(const std::string& stage, const HostImages& arrays, int level) {
    const auto given = [&](const std::string& name) { return arrays.contains(name); };
    int signals = given("illumination1") || given("moments1") || given("color1") ? 2 : 1;
    if (stage == "demodulate" || stage == "antialias") {
        signals = 0;
        for (const SignalInfo& info : signal_table) signals += given(info.name);
    }
    if (stage == "antialias" && method_ != DenoiseMethod::svgf_plus)
        throw InputError("The stage antialias belongs to svgf+ alone.");
    if (signals < 1 || signals > max_signals) throw InputError("A stage needs one or two signals.");
    if (level < 0 || level >= 16) throw InputError("The level is out of range.");
    return with_method([&]<class Method>() {
        allocate<typename Method::Storage>(signals);
        has_history_ = false;
        return signals == 1 ? run_stage_of<Method, 1>(stage, arrays, level)
                            : run_stage_of<Method, 2>(stage, arrays, level);
    });
}

template <class Method, int Signals>
HostImages Denoiser::run_stage_of(const std::string& stage, const HostImages& arrays, int level) {
    using Storage = typename Method::Storage;
    const size_t pixels = this->pixels();
    const auto image = [&](const std::string& name, int channels) -> const HostImage& {
        return find_image(arrays, name, pixels, channels);
    };
    // The working colour of a frame may be borrowed; a stage alone has its own.
    Memory own_working;
    if (!working_) own_working = Memory(device_, pixels * Signals * Storage::color_bytes, "working colour");
    for (int s = 0; s < max_signals; ++s)
        borrowed_[s] = own_working ? own_working.data() + s * pixels * Storage::color_bytes : nullptr;

    // Images are packed and unpacked on the host, by the stages' own code.
    const auto upload_color = [&](Place place, int s, const HostImage& rgb, const HostImage* variance) {
        std::vector<std::byte> memory(pixels * Storage::color_bytes);
        const typename Storage::Color color{memory.data()};
        for (size_t i = 0; i < pixels; ++i)
            color.store(int(i), {rgb.values[3 * i], rgb.values[3 * i + 1], rgb.values[3 * i + 2],
                                 variance ? variance->values[i] : 0.0f});
        device_.upload(color_of<Storage>(place, s).texels, memory.data(), memory.size());
    };
    const auto download_color = [&](Place place, int s, HostImage& rgb, HostImage& variance) {
        std::vector<std::byte> memory(pixels * Storage::color_bytes);
        device_.download(memory.data(), color_of<Storage>(place, s).texels, memory.size());
        const typename Storage::Color color{memory.data()};
        rgb = {3, {}};
        variance = {1, {}};
        for (size_t i = 0; i < pixels; ++i) {
            const Vec4 c = color[int(i)];
            rgb.values.insert(rgb.values.end(), {c.x, c.y, c.z});
            variance.values.push_back(c.w);
        }
    };
    constexpr int moments_channels = sizeof(typename Storage::MomentsValue) / sizeof(float);
    const auto upload_moments = [&](Memory& to, int s, const HostImage& values) {
        std::vector<std::byte> memory(pixels * Storage::moments_bytes);
        const typename Storage::Moments moments{memory.data()};
        using Value = typename Storage::MomentsValue;
        for (size_t i = 0; i < pixels; ++i) {
            Value value;
            std::copy_n(&values.values[i * moments_channels], moments_channels, &value.x);
            moments.store(int(i), value);
        }
        device_.upload(moments_of<Storage>(to, s).texels, memory.data(), memory.size());
    };
    const auto upload_guides = [&](const std::string& prefix, Memory& to, const std::string& length_name) {
        const HostImage &normal = image(prefix + "normal", 3), &depth = image(prefix + "depth", 1),
                        &gradient = image(prefix + "depth_gradient", 2), &id = image(prefix + "object_id", 1);
        const HostImage* length = length_name.empty() ? nullptr : &image(length_name, 1);
        std::vector<std::byte> memory(to.size());
        const typename Storage::Guides guides(memory.data(), width_, height_);
        for (size_t i = 0; i < pixels; ++i) {
            const float* const n = &normal.values[3 * i];
            guides.store(int(i), {n[0], n[1], n[2], depth.values[i]},
                         {gradient.values[2 * i], gradient.values[2 * i + 1]}, int32_t(id.values[i]));
            if (length) guides.store_length(int(i), length->values[i]);
        }
        to.upload(memory);
    };
    const auto download_guides = [&](auto&& take) {
        std::vector<std::byte> memory = guides_.download();
        const typename Storage::Guides guides(memory.data(), width_, height_);
        for (size_t i = 0; i < pixels; ++i) take(guides, int(i));
    };
    const auto numbered = [](const char* name, int s) { return std::string(name) + signal_suffix[s]; };
    const auto given = [&](const std::string& name) { return arrays.contains(name); };
    const auto temporal_only = [&] {
        if (!is_temporal()) throw InputError("The stage " + stage + " belongs to svgf alone.");
    };
    HostImages result;

    // The public images, for the stages that read them.
    std::map<std::string, Buffer<float>> uploads;
    Buffer<int32_t> object_id;
    DenoiseInputs inputs;
    if (stage == "demodulate" || stage == "modulate" || stage == "antialias") {
        HostImages stand_ins = arrays;  // modulate reads no guides and no radiance, but a frame has them
        if (stage == "modulate") {
            stand_ins.insert({"normal", {3, std::vector<float>(3 * pixels)}});
            stand_ins.insert({"depth", {1, std::vector<float>(pixels)}});
        }
        inputs = gather_denoise_inputs([&](const char* name) -> ImageView {
            const auto found = stand_ins.find(name);
            if (found == stand_ins.end()) return {};
            const std::vector<float>& values = found->second.values;
            if (std::string_view(name) == "object_id") {
                object_id = Buffer<int32_t>(device_, values.size(), name);
                object_id.upload(upload_values<int32_t>(found->second));
                return {object_id.data(), 1};
            }
            Buffer<float>& buffer = uploads[name];
            if (!buffer) buffer = Buffer<float>(device_, std::span<const float>(values), name);
            return {buffer.data(), found->second.channels};
        });
    }

    HostImage unused;
    if (stage == "demodulate") {
        repaired_.clear();
        launch("demodulate", demodulate<Storage, Signals>(inputs));
        HostImage normal{3, {}}, depth{1, {}}, gradient{2, {}}, id{1, {}};
        download_guides([&](const typename Storage::Guides& guides, int pixel) {
            const Vec4 n = guides.normal_depth(pixel);
            const Vec2 g = guides.gradient(pixel);
            normal.values.insert(normal.values.end(), {n.x, n.y, n.z});
            depth.values.push_back(n.w);
            gradient.values.insert(gradient.values.end(), {g.x, g.y});
            id.values.push_back(float(guides.object_id(pixel)));
        });
        result = {{"normal", normal}, {"depth", depth}, {"depth_gradient", gradient}, {"object_id", id}};
        for (int s = 0; s < Signals; ++s)
            download_color(Place::working, s, result[numbered("illumination", s)], unused);
    } else if (stage == "temporal") {
        temporal_only();
        repaired_.clear();
        upload_guides("", guides_, "");
        has_history_ = arrays.contains("hist_length");
        if (has_history_) upload_guides("prev_", previous_guides_, "hist_length");
        Buffer<float> motion;
        if (const auto found = arrays.find("motion"); found != arrays.end()) {
            motion = Buffer<float>(device_, std::span<const float>(found->second.values), "motion");
            inputs.motion = motion.data();
            inputs.motion_channels = found->second.channels;
        }
        for (int s = 0; s < Signals; ++s) {
            upload_color(Place::working, s, image(numbered("illumination", s), 3), nullptr);
            if (!has_history_) continue;
            HostImage squares;  // svgf+ keeps the squared luminance after the filter there
            if (given(numbered("hist_filtered", s))) {
                squares = image(numbered("hist_filtered", s), 1);
                for (float& light : squares.values) light = square(light);
            }
            upload_color(Place::history, s, image(numbered("hist_color", s), 3), squares.values.empty() ? nullptr : &squares);
            upload_moments(previous_moments_, s, image(numbered("hist_moments", s), moments_channels));
        }
        Place means = Place::working;
        if constexpr (std::is_same_v<Method, Plus>) {
            inputs.is_specular[1] = true;
            temporal_plus<Signals>(inputs);
            means = Place::history;
        } else {
            launch("temporal", temporal<Storage, Signals>(inputs));
        }
        for (int s = 0; s < Signals; ++s) {
            download_color(means, s, result[numbered("color", s)], result[numbered("variance", s)]);
            std::vector<std::byte> memory(pixels * Storage::moments_bytes);
            device_.download(memory.data(), moments_of<Storage>(moments_, s).texels, memory.size());
            const typename Storage::Moments moments{memory.data()};
            HostImage& values = result[numbered("moments", s)] = {moments_channels, {}};
            for (size_t i = 0; i < pixels; ++i) {
                const auto value = moments[int(i)];
                values.values.insert(values.values.end(), &value.x, &value.x + moments_channels);
            }
        }
        HostImage& length = result["history_length"] = {1, {}};
        download_guides([&](const typename Storage::Guides& guides, int pixel) {
            length.values.push_back(guides.length(pixel));
        });
        has_history_ = false;
    } else if (stage == "variance") {
        if constexpr (!std::is_same_v<Method, Plus>) {
            temporal_only();
            upload_guides("", guides_, "history_length");
            for (int s = 0; s < Signals; ++s) {
                const HostImage& moments = image(numbered("moments", s), 2);
                HostImage variance{1, {}};
                for (size_t i = 0; i < pixels; ++i)
                    variance.values.push_back(moments.values[2 * i + 1]);  // as temporal leaves it
                upload_moments(moments_, s, moments);
                upload_color(Place::working, s, {3, std::vector<float>(3 * pixels)}, &variance);
            }
            variance<Method, Signals>();
            for (int s = 0; s < Signals; ++s) download_color(Place::working, s, unused, result[numbered("variance", s)]);
        } else {
            throw InputError("The stage variance belongs to svgf alone.");
        }
    } else if (stage == "atrous") {
        const Place to = is_temporal() ? Place::history : Place::scratch;
        upload_guides("", guides_, "");
        for (int s = 0; s < Signals; ++s)
            upload_color(Place::working, s, image(numbered("color", s), 3),
                         is_temporal() ? &image(numbered("variance", s), 1) : nullptr);
        if (is_temporal()) {
            atrous<Method, Signals>(level, Place::working, to);
        } else {
            Vec4 window = DenoiseInputs::default_window;
            if (const auto found = arrays.find("window"); found != arrays.end()) {
                const std::vector<float>& edges = found->second.values;
                if (edges.size() != 4) throw InputError("The window needs four numbers.");
                window = {edges[0], edges[1], edges[2], edges[3]};
            }
            edge_avoiding<Signals>(level, window, Place::working, to);
        }
        for (int s = 0; s < Signals; ++s)
            download_color(to, s, result[numbered("color", s)],
                           is_temporal() ? result[numbered("variance", s)] : unused);
    } else if (stage == "modulate") {
        repaired_.clear();
        guides_.clear();
        for (int s = 0; s < Signals; ++s) {
            const std::string name = numbered("variance", s);
            upload_color(Place::working, s, image(numbered("color", s), 3), given(name) ? &image(name, 1) : nullptr);
        }
        Buffer<float> color(device_, 3 * pixels, "color"), spread(device_, pixels, "variance"),
            length(device_, pixels, "history length");
        const DenoiseOutputs outputs{color.data(), spread.data(), length.data()};
        launch("modulate", modulate<Storage, Signals>(inputs, outputs, Place::working));
        result["color"] = {3, color.download()};
        result["variance"] = {1, spread.download()};
    } else if (stage == "antialias") {
        if constexpr (std::is_same_v<Method, Plus>) {
            upload_guides("", guides_, "");
            upload_color(Place::spare, 0, image("unresolved", 3), nullptr);
            for (int s = 0; s < Signals; ++s)
                upload_moments(moments_, s, image(numbered("moments", s), moments_channels));
            has_history_ = has_resolved_ = given("resolved");
            if (has_history_) {
                history_.swap(previous_resolved_);  // upload_color fills history
                HostImage squares = image("resolved_frames", 1);
                for (float& frames : squares.values) frames = square(frames);
                upload_color(Place::history, 0, image("resolved", 3), &squares);
                history_.swap(previous_resolved_);
            }
            Buffer<float> color(device_, 3 * pixels, "color");
            antialias<Signals>(inputs, {color.data(), nullptr, nullptr});
            result["color"] = {3, color.download()};
            history_.swap(previous_resolved_);
            HostImage& frames = result["resolved_frames"];
            download_color(Place::history, 0, unused, frames);
            history_.swap(previous_resolved_);
            for (float& value : frames.values) value = std::sqrt(value);
            has_history_ = has_resolved_ = false;
        }
    } else {
        throw InputError("There is no denoiser stage " + stage + ".");
    }
    return result;
}

}  // namespace svgf
