// SPDX-License-Identifier: Apache-2.0
// Denoiser::run_stage, one stage alone on host images, for tests. Part of denoiser.cpp, which alone includes it.
#pragma once

#include "denoise/denoiser.h"

namespace svgf {

namespace {

const HostImage& find_image(const HostImages& images, const std::string& name, size_t pixels, int channels) {
    const auto found = images.find(name);
    if (found == images.end()) throw InputError("The stage needs the image " + name + ".");
    if (found->second.channels != channels || found->second.values.size() != pixels * channels)
        throw InputError("The image " + name + " needs the frame's size, " + std::to_string(channels) + " channels.");
    return found->second;
}

}  // namespace

// One run of one stage: brings the given images to where the stage reads them, and its results back. Images are packed
// and unpacked on the host, by the stages' own code.
template <class Method, int Signals>
class Denoiser::StageRun {
public:
    StageRun(Denoiser& denoiser, const HostImages& given) : d_(denoiser), given_(given), pixels_(denoiser.pixels()) {
        // What svgf+ borrows during a frame, a stage alone has of its own.
        if constexpr (plus) {
            own_working_ = Memory(d_.device_, pixels_ * Signals * Storage::color_bytes, "working colour");
            own_gradients_ = Memory(d_.device_, pixels_ * Storage::gradient_bytes, "gradients");
            for (int s = 0; s < Signals; ++s)
                d_.borrowed_working_[s] = own_working_.data() + s * pixels_ * Storage::color_bytes;
            d_.borrowed_gradients_ = own_gradients_.data();
            if (Signals == 2) d_.has_reflections_[1] = true;
            d_.all_sharp_ = false;
        }
    }

    HostImages run(const std::string& stage, int level) {
        d_.repaired_.clear();
        const bool is_of_svgf = stage == "temporal" || stage == "variance";
        if ((is_of_svgf && !d_.is_temporal()) || (stage == "variance" && plus))
            throw InputError("The stage " + stage + " belongs to svgf alone.");
        if (stage == "demodulate") demodulate();
        else if (stage == "temporal") temporal();
        else if (stage == "variance") variance();
        else if (stage == "atrous") atrous(level);
        else if (stage == "modulate") modulate();
        else if (stage == "antialias") antialias();
        else throw InputError("There is no denoiser stage " + stage + ".");
        return std::move(result_);
    }

private:
    using Storage = typename Method::Storage;
    using Guides = typename Storage::Guides;
    static constexpr bool plus = std::is_same_v<Method, Plus>;
    static constexpr int moments_channels = sizeof(typename Storage::MomentsValue) / sizeof(float);

    void demodulate() {
        gather_inputs(given_);
        d_.launch("demodulate", d_.demodulate<Storage, Signals>(inputs_));
        HostImage normal{3, {}}, depth{1, {}}, gradient{2, {}}, id{1, {}};
        const std::vector<std::byte> memory = download(d_.gradients<Storage>().texels, Storage::gradient_bytes);
        const typename Storage::Gradients gradients{const_cast<std::byte*>(memory.data())};
        download_guides([&](const Guides& guides, int pixel) {
            const Vec4 n = guides.normal_depth(pixel);
            const Vec2 g = gradients[pixel];
            normal.values.insert(normal.values.end(), {n.x, n.y, n.z});
            depth.values.push_back(min(n.w, background_depth));
            gradient.values.insert(gradient.values.end(), {g.x, g.y});
            id.values.push_back(float(guides.object_id(pixel)));
        });
        result_ = {{"normal", normal}, {"depth", depth}, {"depth_gradient", gradient}, {"object_id", id}};
        for (int s = 0; s < Signals; ++s)
            download_color(Place::working, s, result_[numbered("illumination", s)], unused_);
    }

    void temporal() {
        d_.has_history_ = is_given("hist_color0");
        if (d_.has_history_) upload_history();
        HostImage& length = result_["history_length"] = {1, {}};
        if constexpr (plus) {
            HostImages images = given_;  // without an albedo the illumination stays as it is
            for (const SignalInfo& info : signal_table)
                for (const char* name : {info.name, info.albedo[0], info.albedo[1]})
                    if (name) images.erase(name);
            images["diffuse"] = image("illumination0", 3);
            if (Signals == 2) images["specular"] = image("illumination1", 3);
            gather_inputs(images);
            Buffer<float> lengths(d_.device_, pixels_, "history length");
            d_.temporal_plus<Signals>(inputs_, lengths.data());
            length.values = lengths.download();
        } else {
            upload_guides("", d_.guides_, "");
            upload_gradients();
            for (int s = 0; s < Signals; ++s)
                upload_color(Place::working, s, image(numbered("illumination", s), 3), nullptr);
            Buffer<float> motion;
            if (const auto found = given_.find("motion"); found != given_.end()) {
                motion = Buffer<float>(d_.device_, std::span<const float>(found->second.values), "motion");
                inputs_.motion = motion.data();
                inputs_.motion_channels = found->second.channels;
            }
            d_.launch("temporal", d_.temporal<Storage, Signals>(inputs_));
            download_guides([&](const Guides& guides, int pixel) { length.values.push_back(guides.length(pixel)); });
        }
        for (int s = 0; s < Signals; ++s) {
            download_color(plus ? Place::history : Place::working, s, result_[numbered("color", s)],
                           result_[numbered("variance", s)]);
            result_[numbered("moments", s)] = download_moments(s);
        }
        d_.has_history_ = false;
    }

    void variance() {
        if constexpr (!plus) {
            upload_guides("", d_.guides_, "history_length");
            upload_gradients();
            for (int s = 0; s < Signals; ++s) {
                const HostImage& moments = image(numbered("moments", s), 2);
                HostImage variance{1, {}};
                for (size_t i = 0; i < pixels_; ++i)
                    variance.values.push_back(moments.values[2 * i + 1]);  // as temporal leaves it
                upload_moments(d_.moments_, s, moments);
                upload_color(Place::working, s, {3, std::vector<float>(3 * pixels_)}, &variance);
            }
            d_.variance<Method, Signals>();
            for (int s = 0; s < Signals; ++s)
                download_color(Place::working, s, unused_, result_[numbered("variance", s)]);
        }
    }

    void atrous(int level) {
        const bool has_variance = d_.is_temporal();
        const Place to = has_variance ? Place::history : Place::scratch;
        upload_guides("", d_.guides_, "");
        upload_gradients();
        for (int s = 0; s < Signals; ++s)
            upload_color(Place::working, s, image(numbered("color", s), 3),
                         has_variance ? &image(numbered("variance", s), 1) : nullptr);
        if (has_variance) {
            d_.atrous<Method, Signals>(level, Place::working, to);
        } else {
            Vec4 window = DenoiseInputs::default_window;
            if (const auto found = given_.find("window"); found != given_.end()) {
                const std::vector<float>& edges = found->second.values;
                if (edges.size() != 4) throw InputError("The window needs four numbers.");
                window = {edges[0], edges[1], edges[2], edges[3]};
            }
            d_.edge_avoiding<Signals>(level, window, Place::working, to);
        }
        for (int s = 0; s < Signals; ++s)
            download_color(to, s, result_[numbered("color", s)],
                           has_variance ? result_[numbered("variance", s)] : unused_);
    }

    void modulate() {
        HostImages images = given_;  // it reads no guides and no radiance, but a frame has them
        images.insert({"normal", {3, std::vector<float>(3 * pixels_)}});
        images.insert({"depth", {1, std::vector<float>(pixels_)}});
        gather_inputs(images);
        d_.guides_.clear();
        for (int s = 0; s < Signals; ++s) {
            const std::string name = numbered("variance", s);
            upload_color(Place::working, s, image(numbered("color", s), 3),
                         is_given(name) ? &image(name, 1) : nullptr);
        }
        Buffer<float> color(d_.device_, 3 * pixels_, "color"), spread(d_.device_, pixels_, "variance"),
            length(d_.device_, pixels_, "history length");
        const DenoiseOutputs outputs{color.data(), spread.data(), length.data()};
        d_.launch("modulate", d_.modulate<Storage, Signals>(inputs_, outputs, Place::working));
        result_["color"] = {3, color.download()};
        result_["variance"] = {1, spread.download()};
    }

    void antialias() {
        if constexpr (plus) {
            gather_inputs(given_);
            upload_guides("", d_.guides_, "");
            // The picture is that of the first signal, without an albedo.
            const HostImage none{3, std::vector<float>(3 * pixels_)};
            upload_color(Place::scratch, 0, image("unresolved", 3), nullptr);
            if (Signals == 2) upload_color(Place::scratch, 1, none, nullptr);
            for (int s = 0; s < Signals; ++s)
                upload_moments(d_.moments_, s, image(numbered("moments", s), moments_channels));
            // The resolved picture lies in memory of its own, and passes through working.
            d_.has_history_ = d_.has_resolved_ = is_given("resolved");
            if (d_.has_history_) {
                HostImage squares = image("resolved_frames", 1);
                for (float& frames : squares.values) frames = square(frames);
                upload_color(Place::working, 0, image("resolved", 3), &squares);
                d_.device_.copy(d_.resolved_.data(), own_working_.data(), d_.resolved_.bytes());
            }
            Buffer<float> color(d_.device_, 3 * pixels_, "color"), spread(d_.device_, pixels_, "variance");
            const DenoiseOutputs outputs{color.data(), spread.data(), nullptr};
            d_.antialias(inputs_, d_.modulate<Storage, Signals>(DenoiseInputs{}, outputs, Place::scratch));
            result_["color"] = {3, color.download()};
            d_.device_.copy(own_working_.data(), d_.resolved_.data(), d_.resolved_.bytes());
            HostImage& frames = result_["resolved_frames"];
            download_color(Place::working, 0, unused_, frames);
            for (float& value : frames.values) value = std::sqrt(value);
            d_.has_history_ = d_.has_resolved_ = false;
        }
    }

    bool is_given(const std::string& name) const { return given_.contains(name); }
    const HostImage& image(const std::string& name, int channels) const {
        return find_image(given_, name, pixels_, channels);
    }
    static std::string numbered(const char* name, int s) { return std::string(name) + signal_suffix[s]; }

    // The public images, for the stages that read them.
    void gather_inputs(const HostImages& images) {
        inputs_ = gather_denoise_inputs([&](const char* name) -> ImageView {
            const auto found = images.find(name);
            if (found == images.end()) return {};
            const std::vector<float>& values = found->second.values;
            if (std::string_view(name) == "object_id") {
                object_id_ = Buffer<int32_t>(d_.device_, values.size(), name);
                object_id_.upload(std::vector<int32_t>(values.begin(), values.end()));
                return {object_id_.data(), 1};
            }
            Buffer<float>& buffer = uploads_[name];
            if (!buffer) buffer = Buffer<float>(d_.device_, std::span<const float>(values), name);
            return {buffer.data(), found->second.channels};
        });
    }

    void upload_history() {
        upload_guides("prev_", d_.previous_guides_, plus ? "" : "hist_length");
        for (int s = 0; s < Signals; ++s) {
            HostImage squares;  // svgf+ keeps the squared luminance after the filter there
            if (is_given(numbered("hist_filtered", s))) {
                squares = image(numbered("hist_filtered", s), 1);
                for (float& light : squares.values) light = square(light);
            }
            upload_color(Place::history, s, image(numbered("hist_color", s), 3),
                         squares.values.empty() ? nullptr : &squares);
            upload_moments(d_.previous_moments_, s, image(numbered("hist_moments", s), moments_channels));
        }
    }

    void upload_color(Place place, int s, const HostImage& rgb, const HostImage* variance) {
        std::vector<std::byte> memory(pixels_ * Storage::color_bytes);
        const typename Storage::Color color{memory.data()};
        for (size_t i = 0; i < pixels_; ++i)
            color.store(int(i), {rgb.values[3 * i], rgb.values[3 * i + 1], rgb.values[3 * i + 2],
                                 variance ? variance->values[i] : 0.0f});
        d_.device_.upload(d_.color_of<Storage>(place, s).texels, memory.data(), memory.size());
    }
    void download_color(Place place, int s, HostImage& rgb, HostImage& variance) {
        std::vector<std::byte> memory = download(d_.color_of<Storage>(place, s).texels, Storage::color_bytes);
        const typename Storage::Color color{memory.data()};
        rgb = {3, {}};
        variance = {1, {}};
        for (size_t i = 0; i < pixels_; ++i) {
            const Vec4 c = color[int(i)];
            rgb.values.insert(rgb.values.end(), {c.x, c.y, c.z});
            variance.values.push_back(c.w);
        }
    }

    void upload_moments(Memory& to, int s, const HostImage& values) {
        std::vector<std::byte> memory(pixels_ * Storage::moments_bytes);
        const typename Storage::Moments moments{memory.data()};
        for (size_t i = 0; i < pixels_; ++i) {
            typename Storage::MomentsValue value;
            std::copy_n(&values.values[i * moments_channels], moments_channels, &value.x);
            moments.store(int(i), value);
        }
        d_.device_.upload(d_.moments_of<Storage>(to, s).texels, memory.data(), memory.size());
    }
    HostImage download_moments(int s) {
        std::vector<std::byte> memory = download(d_.moments_of<Storage>(d_.moments_, s).texels, Storage::moments_bytes);
        const typename Storage::Moments moments{memory.data()};
        HostImage values{moments_channels, {}};
        for (size_t i = 0; i < pixels_; ++i) {
            const auto value = moments[int(i)];
            values.values.insert(values.values.end(), &value.x, &value.x + moments_channels);
        }
        return values;
    }

    // length_name: of svgf's history; empty: the guides have none.
    void upload_guides(const std::string& prefix, Memory& to, const std::string& length_name) {
        const HostImage &normal = image(prefix + "normal", 3), &depth = image(prefix + "depth", 1),
                        &id = image(prefix + "object_id", 1);
        [[maybe_unused]] const HostImage* length = length_name.empty() ? nullptr : &image(length_name, 1);
        std::vector<std::byte> memory(to.size());
        const Guides guides(memory.data(), d_.width_, d_.height_);
        for (size_t i = 0; i < pixels_; ++i) {
            const float* const n = &normal.values[3 * i];
            guides.store(int(i), {n[0], n[1], n[2], depth.values[i]}, int32_t(id.values[i]));
            if constexpr (!plus)
                if (length) guides.store_length(int(i), length->values[i]);
        }
        to.upload(memory);
    }
    // take(guides, pixel) for each pixel.
    template <class Take>
    void download_guides(const Take& take) {
        std::vector<std::byte> memory = d_.guides_.download();
        const Guides guides(memory.data(), d_.width_, d_.height_);
        for (size_t i = 0; i < pixels_; ++i) take(guides, int(i));
    }

    void upload_gradients() {
        const HostImage& gradient = image("depth_gradient", 2);
        const HostImage* roughness = is_given("roughness") ? &image("roughness", 1) : nullptr;
        std::vector<std::byte> memory(pixels_ * Storage::gradient_bytes);
        const typename Storage::Gradients gradients{memory.data()};
        for (size_t i = 0; i < pixels_; ++i) {
            const Vec2 slope = {gradient.values[2 * i], gradient.values[2 * i + 1]};
            if constexpr (plus)
                gradients.store(int(i), slope, roughness ? gloss_of(roughness->values[i]) : 1.0f);
            else
                gradients.store(int(i), slope);
        }
        d_.device_.upload(d_.gradients<Storage>().texels, memory.data(), memory.size());
    }

    std::vector<std::byte> download(const void* texels, int bytes_per_pixel) {
        std::vector<std::byte> memory(pixels_ * bytes_per_pixel);
        d_.device_.download(memory.data(), texels, memory.size());
        return memory;
    }

    Denoiser& d_;
    const HostImages& given_;
    size_t pixels_;
    Memory own_working_, own_gradients_;
    std::map<std::string, Buffer<float>> uploads_;
    Buffer<int32_t> object_id_;
    DenoiseInputs inputs_;
    HostImage unused_;
    HostImages result_;
};

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
        return signals == 1 ? StageRun<Method, 1>(*this, arrays).run(stage, level)
                            : StageRun<Method, 2>(*this, arrays).run(stage, level);
    });
}

}  // namespace svgf
