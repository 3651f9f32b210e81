// SPDX-License-Identifier: Apache-2.0
// The denoiser: owns the buffers and the order of the stages.
//
//   method   stages
//   svgf+    demodulate+temporal -> atrous x levels -> modulate+antialias           ours
//   svgf     demodulate -> temporal -> variance -> atrous x levels -> modulate      [Schied17]
//   eaw      demodulate -> atrous x levels -> modulate                              [Dammertz10]
//   none     demodulate -> modulate
//
// Each signal is filtered by itself; geometry, reprojection and edge weights are worked out once for all signals.
// svgf+ works in packed images (storage.h); its first and its last stage are two in one launch. What has been read
// serves again: the history of the frame before for colour between the levels, the guides of the frame before for the
// resolved picture, and until they are written the caller's colour image for colour between the levels and the caller's
// variance image for the depth gradients.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/vec.h"
#include "device/device.h"
#include "denoise/settings.h"

namespace svgf {

enum class DenoiseMethod { none, eaw, svgf, svgf_plus };

std::optional<DenoiseMethod> denoise_method_from_name(std::string_view name);

inline constexpr int max_signals = 2;

// A public image on the device: [H, W, channels], row 0 on top, float32 (object_id: int32). Null: not given.
struct ImageView {
    const void* data = nullptr;
    int channels = 0;
};

// What one frame brings, all on the device. Bad values are repaired (guides.h), not refused.
struct DenoiseInputs {
    int signals = 0;                        // 1 or 2
    const float* signal[max_signals] = {};  // [H, W, 3] radiance
    bool is_specular[max_signals] = {};     // reflections: filtered less, and not tied to the surface's motion
    bool has_reflections[max_signals] = {};  // alone or with other light: all but diffuse
    const float* albedo[max_signals][2] = {};  // [H, W, 3], summed; both null: 1
    const float* roughness = nullptr;       // [H, W] of the specular signal, 0 to 1; null: 0
    const float* emission = nullptr;        // [H, W, 3]; null: 0
    const float* normal = nullptr;          // [H, W, 3] world space
    const float* depth = nullptr;           // [H, W] planar
    const float* depth_gradient = nullptr;  // [H, W, 2] per pixel; null: from differences of depth
    const float* motion = nullptr;          // [H, W, 2 or 3]; null: nothing moved
    int motion_channels = 3;                // 2: the expected previous depth is unknown
    const int32_t* object_id = nullptr;     // [H, W]; null: 1 where depth < 1e10
    bool is_unchanged = false;              // light, surfaces and camera, for as many frames as svgf+ takes to settle
    bool is_interactive = false;            // someone works in the view: what stands still shows no noise meanwhile
    Vec4 window = default_window;           // left, right, bottom, top of the image on the plane one unit ahead

    // Blender's default camera on a square; eaw alone reads the window.
    static constexpr Vec4 default_window = {-0.36f, 0.36f, -0.36f, 0.36f};
};

// Fills the inputs by the public names: signals "diffuse" and "specular", "direct" and "indirect" or "color", with
// "diffuse_albedo", "specular_albedo" or "albedo"; "roughness", "emission", "normal", "depth", "depth_gradient",
// "motion", "object_id". `image` gives each by its name, or an empty view. Throws InputError if no signal is given.
DenoiseInputs gather_denoise_inputs(const std::function<ImageView(const char* name)>& image);

// Where the results go: float32 images on the device, owned by the caller.
struct DenoiseOutputs {
    float* color = nullptr;           // [H, W, 3]
    float* variance = nullptr;        // [H, W] luminance variance that is left in color; 0 unless svgf
    float* history_length = nullptr;  // [H, W] frames in the temporal mean; 1 unless svgf, 0 on the background
};

// Why a pixel has no history, of the nearest of the pixels in which its surface was a frame ago. Mirrored by
// svgf/diagnostics.py, where the reasons are explained.
enum class ResetReason {
    kept, background, restarted, bad_motion, outside, other_object, other_depth, other_normal, light_changed
};
inline constexpr std::string_view reset_reason_names[] = {
    "kept", "background", "restarted", "bad_motion", "outside", "other_object", "other_depth", "other_normal",
    "light_changed"};

// What else a frame can tell: float32 images [H, W] on the device, owned by the caller.
struct DenoiseDiagnostics {
    float* motion_error = nullptr;      // pixels by which the motion misses the surface that it should lead to
    float* reset_reason = nullptr;      // ResetReason
    float* repaired_values = nullptr;   // of the pixel's inputs
    float* suppressed_light = nullptr;  // svgf+: luminance over albedo above the firefly limit, of all signals
};

// An image on the host for run_stage: [H, W, channels] as floats (object ids are exact below 2^24).
struct HostImage {
    int channels = 1;
    std::vector<float> values;
};
using HostImages = std::map<std::string, HostImage>;

// Samples that were brighter than svgf+'s limit, and what was cut from them: luminance over albedo, summed over pixels,
// in 1 / light_units, so that the sum is the same in any order.
struct FireflyCount {
    unsigned long long samples = 0, light = 0;
};
constexpr double light_units = 1024.0;

struct BufferInfo {
    std::string name;
    size_t bytes;
};

struct PackedStorage;
template <int Signals> struct NoisyFrame;
template <class Storage, int Signals> struct Demodulate;
template <class Storage, int Signals> struct Temporal;
template <class Storage, int Signals> struct Modulate;
template <class Storage> struct Reprojection;
template <class Storage, int Signals> struct HistoryImages;

class Denoiser {
public:
    // width, height >= 1. Allocates what one signal needs.
    Denoiser(Device& device, int width, int height, DenoiseMethod method, const DenoiseSettings& settings);

    // Allocates what so many signals need; a frame with more than all before does it, too.
    void prepare(int signals);

    // The next frame is of another size, >= 1; history goes on in it (resample.h).
    void resize(int width, int height);

    // One frame. reset forgets the history first, as does another number of signals than last frame's. diagnostics:
    // null where nobody asks for them.
    void denoise(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, bool reset,
                 const DenoiseDiagnostics* diagnostics = nullptr);

    // What the next frame starts from: per signal the temporal mean "color0" and, of svgf+, the "frames0" in it. Empty
    // without history. Waits for the device.
    HostImages history_images();

    // Takes effect at the next frame, history stays.
    void set_settings(const DenoiseSettings& settings) { settings_ = settings; }

    // Bytes that each stage of the last frame had to move at least: every image that it reads or writes, once.
    using Traffic = std::vector<std::pair<std::string, size_t>>;
    const Traffic& traffic() const { return traffic_; }

    // Values of the last frame's (or stage's) inputs and history that were repaired. Waits for the device.
    int repaired() const;

    // Samples that svgf+ scaled down in the last frame. Waits for the device.
    FireflyCount fireflies() const;

    std::vector<BufferInfo> buffers() const;

    // One stage alone, on host images; for tests. Uses this denoiser's buffers, so it ends the history. level: of
    // "atrous". Names ending in a digit are one per signal, from 0; guides: normal, depth, depth_gradient, object_id.
    //   demodulate  the public images -> illumination0, guides
    //   temporal    illumination0, guides, motion, and unless there is no history prev_ + guides, hist_color0,
    //               hist_moments0, hist_length -> color0, moments0, history_length
    //   variance    moments0, history_length, guides -> variance0
    //   atrous      color0, variance0, guides, (eaw: window) -> color0, variance0 (svgf)
    //   modulate    color0, variance0 (svgf), the public images -> color, variance
    //   antialias   unresolved, moments0, the public images, guides, resolved, resolved_frames
    //               -> color, resolved_frames
    // temporal of svgf+: moments are frames, variance, drift and changed, hist_filtered0 is the luminance after the
    // filter, variance0 goes with color0, signal 1 is the specular one, whose roughness atrous reads if it is given,
    // and there are no prev_depth_gradient and hist_length.
    HostImages run_stage(const std::string& stage, const HostImages& arrays, int level = 0);

    Device& device() { return device_; }
    int width() const { return width_; }
    int height() const { return height_; }
    DenoiseMethod method() const { return method_; }

private:
    using Memory = Buffer<std::byte>;
    // Where colour lies between the stages. svgf: `working` is what temporal leaves, `history` the first level
    // [Schied17]. svgf+: `history` is what temporal leaves, scratch the history of the frame before.
    enum class Place { working, scratch, history };

    bool is_temporal() const { return method_ == DenoiseMethod::svgf || method_ == DenoiseMethod::svgf_plus; }
    int levels() const { return method_ == DenoiseMethod::none ? 0 : settings_.levels; }
    size_t pixels() const { return size_t(width_) * height_; }

    // For all signals together; what is there is kept.
    template <class Storage> void allocate(int signals);
    template <class Storage> typename Storage::Guides guides_of(Memory& memory);
    template <class Storage> typename Storage::Gradients gradients();
    template <class Storage> typename Storage::Color color_of(Place place, int signal);
    template <class Storage> typename Storage::Moments moments_of(Memory& memory, int signal);
    template <class Run> auto with_method(Run run);
    template <class Storage, int Signals> HistoryImages<Storage, Signals> history_views();
    template <class Storage, int Signals> void resample(int width, int height);

    template <class Method, int Signals> void run(const DenoiseInputs& inputs, const DenoiseOutputs& outputs);
    template <int Signals> void run_plus(const DenoiseInputs& inputs, const DenoiseOutputs& outputs);
    template <int Signals> NoisyFrame<Signals> noisy_frame(const DenoiseInputs& inputs) const;
    template <class Storage, int Signals> Demodulate<Storage, Signals> demodulate(const DenoiseInputs& inputs);
    template <class Storage> Reprojection<Storage> reprojection(const DenoiseInputs& inputs);
    template <class Storage, int Signals> Temporal<Storage, Signals> temporal(const DenoiseInputs& inputs);
    template <int Signals> void temporal_plus(const DenoiseInputs& inputs, float* history_length);
    template <class Storage, int Signals> void diagnose(const DenoiseInputs& inputs);
    template <int Signals>
    void antialias(const DenoiseInputs& inputs, const Modulate<PackedStorage, Signals>& modulate);
    template <class Method, int Signals> void variance();
    template <class Method, int Signals, class Sink>
    void atrous(const char* name, int level, Place from, const Sink& sink);
    template <class Method, int Signals> void atrous(int level, Place from, Place to);
    template <int Signals> void edge_avoiding(int level, const Vec4& window, Place from, Place to);
    template <class Storage, int Signals>
    Modulate<Storage, Signals> modulate(const DenoiseInputs& inputs, const DenoiseOutputs& outputs, Place from);
    template <class Method, int Signals> class StageRun;

    template <class Stage> void launch(const char* name, const Stage& stage);
    template <class Stage> void launch_tiles(const char* name, const Stage& stage);
    void add_traffic(const char* name, int bytes_per_pixel);

    Device& device_;
    int width_, height_;
    DenoiseMethod method_;
    DenoiseSettings settings_;
    int signals_ = 0;           // of the last frame
    bool has_history_ = false;  // previous_guides_, history_ and previous_moments_ hold the frame before
    Memory guides_, previous_guides_;
    Memory working_, scratch_, history_;  // colour, one image per signal after the other
    Memory moments_, previous_moments_;   // of luminance, likewise
    Memory next_history_;                 // svgf+: temporal writes it while it reads history_
    Memory resolved_;                     // svgf+: what antialias has written
    // Of the frame at hand; all_sharp_: any light of any pixel may be a sharp reflection.
    bool has_reflections_[max_signals] = {}, all_sharp_ = false;
    bool has_resolved_ = false;
    const DenoiseDiagnostics* diagnostics_ = nullptr;  // during a frame that was asked for them
    std::byte* borrowed_working_[max_signals] = {};  // svgf+, during a frame: memory that is another's
    std::byte* borrowed_gradients_ = nullptr;
    Buffer<int> repaired_;
    Buffer<FireflyCount> fireflies_;
    Traffic traffic_;
};

}  // namespace svgf
