// SPDX-License-Identifier: Apache-2.0
#include "denoise/denoiser.h"

#include <utility>

#include "denoise/atrous.h"
#include "denoise/demodulate.h"
#include "denoise/modulate.h"
#include "denoise/temporal.h"
#include "denoise/variance.h"

namespace svgf {

namespace {

// Every signal that can be denoised, and the albedos whose sum it is divided by.
struct SignalInfo {
    const char* name;
    const char* albedo[2];
};
constexpr SignalInfo signal_table[] = {
    {"diffuse", {"diffuse_albedo", nullptr}},
    {"specular", {"specular_albedo", nullptr}},
    {"direct", {"diffuse_albedo", "specular_albedo"}},
    {"indirect", {"diffuse_albedo", "specular_albedo"}},
    {"color", {"albedo", nullptr}},
};

const char* const signal_suffix[max_signals] = {"0", "1"};

}  // namespace

std::optional<DenoiseMethod> denoise_method_from_name(std::string_view name) {
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

Denoiser::Denoiser(Device& device, int width, int height, DenoiseMethod method, const DenoiseSettings& settings)
    : device_(device), width_(width), height_(height), method_(method), settings_(settings) {
    const size_t pixels = size_t(width) * height;
    geometry_ = {Buffer<Vec4>(device, pixels, "normal and depth"), Buffer<Vec2>(device, pixels, "depth gradient"),
                 Buffer<int32_t>(device, pixels, "object id"), {}};
    if (method == DenoiseMethod::svgf) {
        geometry_.history_length = Buffer<float>(device, pixels, "history length");
        previous_ = {Buffer<Vec4>(device, pixels, "previous normal and depth"),
                     Buffer<Vec2>(device, pixels, "previous depth gradient"),
                     Buffer<int32_t>(device, pixels, "previous object id"),
                     Buffer<float>(device, pixels, "previous history length")};
    }
    repaired_ = Buffer<int>(device, 1, "repair counter");
    repaired_.clear();
    allocate_signal(0);
}

void Denoiser::allocate_signal(int signal) {
    SignalBuffers& buffers = signal_[signal];
    if (buffers.working) return;
    const size_t pixels = size_t(width_) * height_;
    buffers.scratch = Buffer<Vec4>(device_, pixels, "scratch");
    if (method_ == DenoiseMethod::svgf) {
        buffers.history = Buffer<Vec4>(device_, pixels, "history");
        buffers.moments = Buffer<Vec2>(device_, pixels, "moments");
        buffers.previous_moments = Buffer<Vec2>(device_, pixels, "previous moments");
    }
    buffers.working = Buffer<Vec4>(device_, pixels, "working");
}

void Denoiser::denoise(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, bool reset) {
    for (int s = 0; s < inputs.signals; ++s) allocate_signal(s);
    if (reset || inputs.signals != signals_) has_history_ = false;
    signals_ = inputs.signals;
    try {
        if (signals_ == 1)
            run<1>(inputs, outputs);
        else
            run<2>(inputs, outputs);
    } catch (...) {
        has_history_ = false;  // the buffers hold half a frame
        throw;
    }
}

template <int Signals>
void Denoiser::run(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    demodulate<Signals>(inputs);
    if (method_ == DenoiseMethod::svgf) {
        temporal<Signals>(inputs);
        variance<Signals>();
    }
    for (int level = 0; level < levels(); ++level) atrous<Signals>(level, inputs.window);
    modulate<Signals>(inputs, outputs);
    if (method_ != DenoiseMethod::svgf) return;
    if (levels() == 0)  // then the means themselves are the history; modulate has read them
        for (int s = 0; s < Signals; ++s) signal_[s].history.swap(signal_[s].working);
    for (int s = 0; s < Signals; ++s) signal_[s].moments.swap(signal_[s].previous_moments);
    std::swap(geometry_, previous_);
    has_history_ = true;
}

// The frame's guides; illumination in `working`.
template <int Signals>
void Denoiser::demodulate(const DenoiseInputs& inputs) {
    repaired_.clear();
    Demodulate<Signals> stage;
    stage.width = width_;
    stage.height = height_;
    stage.in_normal = inputs.normal;
    stage.in_depth = inputs.depth;
    stage.in_depth_gradient = inputs.depth_gradient;
    stage.in_object_id = inputs.object_id;
    stage.out_normal_depth = geometry_.normal_depth.data();
    stage.out_gradient = geometry_.gradient.data();
    stage.out_object_id = geometry_.object_id.data();
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_signal[s] = inputs.signal[s];
        for (int i = 0; i < 2; ++i) stage.in_albedo[s][i] = inputs.albedo[s][i];
        stage.out_illumination[s] = signal_[s].working.data();
    }
    device_.launch("demodulate", width_, height_, stage);
}

Guides Denoiser::guides_of(const GeometryBuffers& buffers) const {
    return {buffers.normal_depth.data(), buffers.gradient.data(), buffers.object_id.data(), width_, height_};
}

// From `working` and `history` through `scratch` to `working` with its variance over time.
template <int Signals>
void Denoiser::temporal(const DenoiseInputs& inputs) {
    Temporal<Signals> stage;
    stage.guides = guides_of(geometry_);
    stage.prev_guides = has_history_ ? guides_of(previous_) : Guides{};
    stage.in_motion = inputs.motion;
    stage.motion_channels = inputs.motion_channels;
    stage.hist_length = previous_.history_length.data();
    stage.alpha = settings_.alpha;
    stage.alpha_moments = settings_.alpha_moments;
    stage.depth_tolerance = settings_.depth_tolerance;
    stage.normal_tolerance = settings_.normal_tolerance;
    stage.out_length = geometry_.history_length.data();
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_illumination[s] = signal_[s].working.data();
        stage.hist_color[s] = signal_[s].history.data();
        stage.hist_moments[s] = signal_[s].previous_moments.data();
        stage.out_color[s] = signal_[s].scratch.data();
        stage.out_moments[s] = signal_[s].moments.data();
    }
    device_.launch("temporal", width_, height_, stage);
    for (int s = 0; s < Signals; ++s) signal_[s].working.swap(signal_[s].scratch);
}

// In place: only the variance of `working` changes, and no other pixel reads it.
template <int Signals>
void Denoiser::variance() {
    Variance<Signals> stage;
    stage.guides = guides_of(geometry_);
    stage.in_length = geometry_.history_length.data();
    stage.sigma_depth = settings_.sigma_depth;
    stage.sigma_normal = settings_.sigma_normal;
    stage.spatial_variance_frames = settings_.spatial_variance_frames;
    for (int s = 0; s < Signals; ++s) {
        stage.in_moments[s] = signal_[s].moments.data();
        stage.out_color[s] = signal_[s].working.data();
    }
    device_.launch("variance", width_, height_, stage);
}

// Where a signal's colour is after `levels` levels. SVGF's first level is the next frame's history [Schied17]: it is
// written there, and level 1 reads it there, so that feedback costs no copy.
Buffer<Vec4>& Denoiser::filtered(int signal, int levels) {
    SignalBuffers& buffers = signal_[signal];
    return method_ == DenoiseMethod::svgf && levels == 1 ? buffers.history : buffers.working;
}

template <int Signals>
void Denoiser::atrous(int level, const Vec4& window) {
    const bool svgf = method_ == DenoiseMethod::svgf, to_history = svgf && level == 0;
    const auto launch = [&](auto stage) {
        stage.guides = guides_of(geometry_);
        stage.level = level;
        for (int s = 0; s < Signals; ++s) {
            stage.in_color[s] = filtered(s, level).data();
            stage.out_color[s] = (to_history ? signal_[s].history : signal_[s].scratch).data();
        }
        device_.launch("atrous", width_, height_, stage);
    };
    if (svgf) {
        Atrous<Signals> stage;
        stage.sigma_depth = settings_.sigma_depth;
        stage.sigma_normal = settings_.sigma_normal;
        stage.sigma_luminance = settings_.sigma_luminance;
        launch(stage);
    } else {
        EdgeAvoiding<Signals> stage;
        stage.window = window;
        stage.sigma_color = settings_.eaw_sigma_color;
        stage.sigma_normal = settings_.eaw_sigma_normal;
        stage.sigma_position = settings_.eaw_sigma_position;
        launch(stage);
    }
    if (to_history) return;
    for (int s = 0; s < Signals; ++s) signal_[s].working.swap(signal_[s].scratch);
}

template <int Signals>
void Denoiser::modulate(const DenoiseInputs& inputs, const DenoiseOutputs& outputs) {
    Modulate<Signals> stage;
    stage.width = width_;
    stage.in_emission = inputs.emission;
    stage.in_normal_depth = geometry_.normal_depth.data();
    stage.in_length = geometry_.history_length.data();  // null unless svgf
    stage.out_color = outputs.color;
    stage.out_variance = outputs.variance;
    stage.out_history_length = outputs.history_length;
    stage.out_repaired = repaired_.data();
    for (int s = 0; s < Signals; ++s) {
        stage.in_color[s] = filtered(s, levels()).data();
        for (int i = 0; i < 2; ++i) stage.in_albedo[s][i] = inputs.albedo[s][i];
    }
    device_.launch("modulate", width_, height_, stage);
}

int Denoiser::repaired() const { return repaired_.download()[0]; }

std::vector<BufferInfo> Denoiser::buffers() const {
    std::vector<BufferInfo> list;
    const auto add = [&](const std::string& name, const auto& buffer) {
        if (buffer) list.push_back({name, buffer.bytes()});
    };
    for (const auto& [prefix, geometry] :
         {std::pair<const char*, const GeometryBuffers*>{"", &geometry_}, {"previous ", &previous_}}) {
        add(std::string(prefix) + "normal and depth", geometry->normal_depth);
        add(std::string(prefix) + "depth gradient", geometry->gradient);
        add(std::string(prefix) + "object id", geometry->object_id);
        add(std::string(prefix) + "history length", geometry->history_length);
    }
    for (int s = 0; s < max_signals; ++s) {
        const std::string signal = std::string(" ") + signal_suffix[s];
        add("working" + signal, signal_[s].working);
        add("scratch" + signal, signal_[s].scratch);
        add("history" + signal, signal_[s].history);
        add("moments" + signal, signal_[s].moments);
        add("previous moments" + signal, signal_[s].previous_moments);
    }
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

// A Vec4 image from three channels and, where there is one, a fourth from another image.
std::vector<Vec4> join(const HostImage& rgb, const HostImage* w) {
    std::vector<Vec4> joined(rgb.values.size() / 3);
    for (size_t i = 0; i < joined.size(); ++i)
        joined[i] = {rgb.values[3 * i], rgb.values[3 * i + 1], rgb.values[3 * i + 2], w ? w->values[i] : 0.0f};
    return joined;
}

HostImage rgb_of(const std::vector<Vec4>& joined) {
    HostImage image{3, {}};
    for (const Vec4& v : joined) image.values.insert(image.values.end(), {v.x, v.y, v.z});
    return image;
}

HostImage w_of(const std::vector<Vec4>& joined) {
    HostImage image{1, {}};
    for (const Vec4& v : joined) image.values.push_back(v.w);
    return image;
}

std::vector<Vec2> pairs(const HostImage& image) {
    std::vector<Vec2> result(image.values.size() / 2);
    for (size_t i = 0; i < result.size(); ++i) result[i] = {image.values[2 * i], image.values[2 * i + 1]};
    return result;
}

HostImage pairs(const std::vector<Vec2>& image) {
    HostImage result{2, {}};
    for (const Vec2& v : image) result.values.insert(result.values.end(), {v.x, v.y});
    return result;
}

template <class T>
std::vector<T> upload_values(const HostImage& image) {
    return std::vector<T>(image.values.begin(), image.values.end());
}

}  // namespace

void Denoiser::upload_guides(const HostImages& arrays, const std::string& prefix, GeometryBuffers& buffers) {
    const size_t pixels = size_t(width_) * height_;
    buffers.normal_depth.upload(join(find_image(arrays, prefix + "normal", pixels, 3),
                                     &find_image(arrays, prefix + "depth", pixels, 1)));
    buffers.gradient.upload(pairs(find_image(arrays, prefix + "depth_gradient", pixels, 2)));
    buffers.object_id.upload(upload_values<int32_t>(find_image(arrays, prefix + "object_id", pixels, 1)));
}

HostImages Denoiser::run_stage(const std::string& stage, const HostImages& arrays, int level) {
    const auto given = [&](const std::string& name) { return arrays.contains(name); };
    int signals = given("illumination1") || given("moments1") || given("color1") ? 2 : 1;
    if (stage == "demodulate") {
        signals = 0;
        for (const SignalInfo& info : signal_table) signals += given(info.name);
    }
    if (signals < 1 || signals > max_signals) throw InputError("A stage needs one or two signals.");
    if (level < 0 || level >= 16) throw InputError("The level is out of range.");
    for (int s = 0; s < signals; ++s) allocate_signal(s);
    has_history_ = false;
    return signals == 1 ? run_stage_of<1>(stage, arrays, level) : run_stage_of<2>(stage, arrays, level);
}

template <int Signals>
HostImages Denoiser::run_stage_of(const std::string& stage, const HostImages& arrays, int level) {
    const size_t pixels = size_t(width_) * height_;
    const auto image = [&](const std::string& name, int channels) -> const HostImage& {
        return find_image(arrays, name, pixels, channels);
    };
    const auto numbered = [](const char* name, int s) { return std::string(name) + signal_suffix[s]; };
    const auto temporal_only = [&] {
        if (method_ != DenoiseMethod::svgf) throw InputError("The stage " + stage + " belongs to svgf alone.");
    };
    HostImages result;

    // The public images, for the stages that read them.
    std::map<std::string, Buffer<float>> uploads;
    Buffer<int32_t> object_id;
    DenoiseInputs inputs;
    if (stage == "demodulate" || stage == "modulate") {
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

    if (stage == "demodulate") {
        demodulate<Signals>(inputs);
        const std::vector<Vec4> normal_depth = geometry_.normal_depth.download();
        result["normal"] = rgb_of(normal_depth);
        result["depth"] = w_of(normal_depth);
        result["depth_gradient"] = pairs(geometry_.gradient.download());
        const std::vector<int32_t> ids = geometry_.object_id.download();
        result["object_id"] = {1, std::vector<float>(ids.begin(), ids.end())};
        for (int s = 0; s < Signals; ++s)
            result[numbered("illumination", s)] = rgb_of(signal_[s].working.download());
    } else if (stage == "temporal") {
        temporal_only();
        repaired_.clear();
        upload_guides(arrays, "", geometry_);
        has_history_ = arrays.contains("hist_length");
        if (has_history_) {
            upload_guides(arrays, "prev_", previous_);
            previous_.history_length.upload(image("hist_length", 1).values);
        }
        Buffer<float> motion;
        if (const auto found = arrays.find("motion"); found != arrays.end()) {
            motion = Buffer<float>(device_, std::span<const float>(found->second.values), "motion");
            inputs.motion = motion.data();
            inputs.motion_channels = found->second.channels;
        }
        for (int s = 0; s < Signals; ++s) {
            signal_[s].working.upload(join(image(numbered("illumination", s), 3), nullptr));
            if (!has_history_) continue;
            signal_[s].history.upload(join(image(numbered("hist_color", s), 3), nullptr));
            signal_[s].previous_moments.upload(pairs(image(numbered("hist_moments", s), 2)));
        }
        temporal<Signals>(inputs);
        for (int s = 0; s < Signals; ++s) {
            result[numbered("color", s)] = rgb_of(signal_[s].working.download());
            result[numbered("moments", s)] = pairs(signal_[s].moments.download());
        }
        result["history_length"] = {1, geometry_.history_length.download()};
        has_history_ = false;
    } else if (stage == "variance") {
        temporal_only();
        upload_guides(arrays, "", geometry_);
        geometry_.history_length.upload(image("history_length", 1).values);
        for (int s = 0; s < Signals; ++s) {
            std::vector<Vec4> color(pixels);
            const std::vector<Vec2> moments = pairs(image(numbered("moments", s), 2));
            for (size_t i = 0; i < pixels; ++i) color[i].w = moments[i].y;  // as temporal leaves it
            signal_[s].moments.upload(moments);
            signal_[s].working.upload(color);
        }
        variance<Signals>();
        for (int s = 0; s < Signals; ++s) result[numbered("variance", s)] = w_of(signal_[s].working.download());
    } else if (stage == "atrous") {
        const bool svgf = method_ == DenoiseMethod::svgf;
        upload_guides(arrays, "", geometry_);
        for (int s = 0; s < Signals; ++s)
            filtered(s, level).upload(join(image(numbered("color", s), 3),
                                           svgf ? &image(numbered("variance", s), 1) : nullptr));
        Vec4 window = DenoiseInputs::default_window;
        if (const auto found = arrays.find("window"); found != arrays.end()) {
            const std::vector<float>& edges = found->second.values;
            if (edges.size() != 4) throw InputError("The window needs four numbers.");
            window = {edges[0], edges[1], edges[2], edges[3]};
        }
        atrous<Signals>(level, window);
        for (int s = 0; s < Signals; ++s) {
            const std::vector<Vec4> color = filtered(s, level + 1).download();
            result[numbered("color", s)] = rgb_of(color);
            if (svgf) result[numbered("variance", s)] = w_of(color);
        }
    } else if (stage == "modulate") {
        repaired_.clear();
        geometry_.normal_depth.clear();
        for (int s = 0; s < Signals; ++s)
            filtered(s, levels()).upload(join(image(numbered("color", s), 3),
                                              arrays.contains(numbered("variance", s))
                                                  ? &image(numbered("variance", s), 1)
                                                  : nullptr));
        Buffer<float> color(device_, 3 * pixels, "color"), spread(device_, pixels, "variance"),
            length(device_, pixels, "history length");
        modulate<Signals>(inputs, {color.data(), spread.data(), length.data()});
        result["color"] = {3, color.download()};
        result["variance"] = {1, spread.download()};
    } else {
        throw InputError("There is no denoiser stage " + stage + ".");
    }
    return result;
}

}  // namespace svgf
