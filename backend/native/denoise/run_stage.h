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
    const auto given = [&](const std::string& name) { return arrays.contains(name); };
    const auto image = [&](const std::string& name, int channels) -> const HostImage& {
        return find_image(arrays, name, pixels, channels);
    };
    // What svgf+ borrows during a frame, a stage alone has of its own.
    constexpr bool plus = std::is_same_v<Method, Plus>;
    Memory own_working, own_gradients;
    if constexpr (plus) {
        own_working = Memory(device_, pixels * Signals * Storage::color_bytes, "working colour");
        own_gradients = Memory(device_, pixels * Storage::gradient_bytes, "gradients");
        for (int s = 0; s < Signals; ++s)
            borrowed_working_[s] = own_working.data() + s * pixels * Storage::color_bytes;
        borrowed_gradients_ = own_gradients.data();
        if (Signals == 2) has_reflections_[1] = true;
        all_sharp_ = false;
    }

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
                        &id = image(prefix + "object_id", 1);
        const HostImage* length = length_name.empty() ? nullptr : &image(length_name, 1);
        std::vector<std::byte> memory(to.size());
        const typename Storage::Guides guides(memory.data(), width_, height_);
        for (size_t i = 0; i < pixels; ++i) {
            const float* const n = &normal.values[3 * i];
            guides.store(int(i), {n[0], n[1], n[2], depth.values[i]}, int32_t(id.values[i]));
            if constexpr (!plus)
                if (length) guides.store_length(int(i), length->values[i]);
        }
        to.upload(memory);
    };
    const auto upload_gradients = [&] {
        const HostImage& gradient = image("depth_gradient", 2);
        std::vector<std::byte> memory(pixels * Storage::gradient_bytes);
        const typename Storage::Gradients gradients{memory.data()};
        for (size_t i = 0; i < pixels; ++i) {
            const Vec2 slope = {gradient.values[2 * i], gradient.values[2 * i + 1]};
            if constexpr (plus)
                gradients.store(int(i), slope, given("roughness") ? gloss_of(image("roughness", 1).values[i]) : 1.0f);
            else
                gradients.store(int(i), slope);
        }
        device_.upload(this->gradients<Storage>().texels, memory.data(), memory.size());
    };
    const auto download_guides = [&](auto&& take) {
        std::vector<std::byte> memory = guides_.download();
        const typename Storage::Guides guides(memory.data(), width_, height_);
        for (size_t i = 0; i < pixels; ++i) take(guides, int(i));
    };
    const auto numbered = [](const char* name, int s) { return std::string(name) + signal_suffix[s]; };
    const auto temporal_only = [&] {
        if (!is_temporal()) throw InputError("The stage " + stage + " belongs to svgf alone.");
    };
    HostImages result;

    // The public images, for the stages that read them.
    std::map<std::string, Buffer<float>> uploads;
    Buffer<int32_t> object_id;
    DenoiseInputs inputs;
    const bool demodulates = plus && stage == "temporal";
    if (demodulates || stage == "demodulate" || stage == "modulate" || stage == "antialias") {
        HostImages stand_ins = arrays;  // modulate reads no guides and no radiance, but a frame has them
        if (stage == "modulate") {
            stand_ins.insert({"normal", {3, std::vector<float>(3 * pixels)}});
            stand_ins.insert({"depth", {1, std::vector<float>(pixels)}});
        }
        if (demodulates) {  // without an albedo the illumination stays as it is
            for (const SignalInfo& info : signal_table)
                for (const char* name : {info.name, info.albedo[0], info.albedo[1]})
                    if (name) stand_ins.erase(name);
            stand_ins["diffuse"] = image("illumination0", 3);
            if (Signals == 2) stand_ins["specular"] = image("illumination1", 3);
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
        std::vector<std::byte> memory(pixels * Storage::gradient_bytes);
        device_.download(memory.data(), gradients<Storage>().texels, memory.size());
        const typename Storage::Gradients gradients{memory.data()};
        download_guides([&](const typename Storage::Guides& guides, int pixel) {
            const Vec4 n = guides.normal_depth(pixel);
            const Vec2 g = gradients[pixel];
            normal.values.insert(normal.values.end(), {n.x, n.y, n.z});
            depth.values.push_back(min(n.w, background_depth));
            gradient.values.insert(gradient.values.end(), {g.x, g.y});
            id.values.push_back(float(guides.object_id(pixel)));
        });
        result = {{"normal", normal}, {"depth", depth}, {"depth_gradient", gradient}, {"object_id", id}};
        for (int s = 0; s < Signals; ++s)
            download_color(Place::working, s, result[numbered("illumination", s)], unused);
    } else if (stage == "temporal") {
        temporal_only();
        repaired_.clear();
        has_history_ = given("hist_color0");
        if (has_history_) upload_guides("prev_", previous_guides_, plus ? "" : "hist_length");
        for (int s = 0; s < Signals; ++s) {
            if (!has_history_) continue;
            HostImage squares;  // svgf+ keeps the squared luminance after the filter there
            if (given(numbered("hist_filtered", s))) {
                squares = image(numbered("hist_filtered", s), 1);
                for (float& light : squares.values) light = square(light);
            }
            upload_color(Place::history, s, image(numbered("hist_color", s), 3),
                         squares.values.empty() ? nullptr : &squares);
            upload_moments(previous_moments_, s, image(numbered("hist_moments", s), moments_channels));
        }
        HostImage& length = result["history_length"] = {1, {}};
        Place means = Place::working;
        if constexpr (plus) {
            Buffer<float> lengths(device_, pixels, "history length");
            temporal_plus<Signals>(inputs, lengths.data());
            means = Place::history;
            length.values = lengths.download();
        } else {
            upload_guides("", guides_, "");
            upload_gradients();
            for (int s = 0; s < Signals; ++s)
                upload_color(Place::working, s, image(numbered("illumination", s), 3), nullptr);
            Buffer<float> motion;
            if (const auto found = arrays.find("motion"); found != arrays.end()) {
                motion = Buffer<float>(device_, std::span<const float>(found->second.values), "motion");
                inputs.motion = motion.data();
                inputs.motion_channels = found->second.channels;
            }
            launch("temporal", temporal<Storage, Signals>(inputs));
            download_guides([&](const typename Storage::Guides& guides, int pixel) {
                length.values.push_back(guides.length(pixel));
            });
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
        has_history_ = false;
    } else if (stage == "variance") {
        if constexpr (!plus) {
            temporal_only();
            upload_guides("", guides_, "history_length");
            upload_gradients();
            for (int s = 0; s < Signals; ++s) {
                const HostImage& moments = image(numbered("moments", s), 2);
                HostImage variance{1, {}};
                for (size_t i = 0; i < pixels; ++i)
                    variance.values.push_back(moments.values[2 * i + 1]);  // as temporal leaves it
                upload_moments(moments_, s, moments);
                upload_color(Place::working, s, {3, std::vector<float>(3 * pixels)}, &variance);
            }
            variance<Method, Signals>();
            for (int s = 0; s < Signals; ++s)
                download_color(Place::working, s, unused, result[numbered("variance", s)]);
        } else {
            throw InputError("The stage variance belongs to svgf alone.");
        }
    } else if (stage == "atrous") {
        const Place to = is_temporal() ? Place::history : Place::scratch;
        upload_guides("", guides_, "");
        upload_gradients();
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
        if constexpr (plus) {
            upload_guides("", guides_, "");
            // The picture is that of the first signal, without an albedo.
            const HostImage none{3, std::vector<float>(3 * pixels)};
            upload_color(Place::scratch, 0, image("unresolved", 3), nullptr);
            if (Signals == 2) upload_color(Place::scratch, 1, none, nullptr);
            for (int s = 0; s < Signals; ++s)
                upload_moments(moments_, s, image(numbered("moments", s), moments_channels));
            // The resolved picture lies in memory of its own, and passes through working.
            has_history_ = has_resolved_ = given("resolved");
            if (has_history_) {
                HostImage squares = image("resolved_frames", 1);
                for (float& frames : squares.values) frames = square(frames);
                upload_color(Place::working, 0, image("resolved", 3), &squares);
                device_.copy(resolved_.data(), own_working.data(), resolved_.bytes());
            }
            Buffer<float> color(device_, 3 * pixels, "color");
            Buffer<float> spread(device_, pixels, "variance");
            DenoiseInputs picture;
            antialias(inputs, modulate<Storage, Signals>(picture, {color.data(), spread.data()}, Place::scratch));
            result["color"] = {3, color.download()};
            device_.copy(own_working.data(), resolved_.data(), resolved_.bytes());
            HostImage& frames = result["resolved_frames"];
            download_color(Place::working, 0, unused, frames);
            for (float& value : frames.values) value = std::sqrt(value);
            has_history_ = has_resolved_ = false;
        }
    } else {
        throw InputError("There is no denoiser stage " + stage + ".");
    }
    return result;
}

}  // namespace svgf
