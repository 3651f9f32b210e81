// SPDX-License-Identifier: Apache-2.0
// gather_denoise_inputs: from images by their public names to what the denoiser reads.
#include "denoise/signals.h"

namespace svgf {

DenoiseInputs gather_denoise_inputs(const std::function<ImageView(const char* name)>& image) {
    DenoiseInputs inputs;
    const auto floats = [&](const char* name) { return static_cast<const float*>(image(name).data); };
    for (const SignalInfo& info : signal_table) {
        const float* signal = floats(info.name);
        if (!signal) continue;
        if (inputs.signals == max_signals) throw InputError("More than two signals are given.");
        inputs.signal[inputs.signals] = signal;
        inputs.is_specular[inputs.signals] = info.is_specular;
        inputs.has_reflections[inputs.signals] = info.has_reflections;
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

}  // namespace svgf
