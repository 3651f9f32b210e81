// SPDX-License-Identifier: Apache-2.0
// How the images between the stages are stored. A stage is written once, for a Storage:
//
//   FloatStorage    float32: what the papers' methods are held to the reference with.
//   PackedStorage   about a third of that: a texel of guides and one of colour are 8 bytes each. The errors
//                   (core/packing.h) are far below the noise; tests state how far.
//
// Guides are what the stages know of the surfaces behind the pixels, and what the next frame finds its history by.
// Where there is no surface, depth is background_depth or more, the object id 0 and the rest 0 or of no meaning.
// Gradients are those of depth per pixel; a frame's own alone are ever read.
//
// fetch() reads a texel as it is stored; what needs it as numbers unpacks it later.
#pragma once

#include "core/approximate.h"
#include "core/load.h"
#include "core/packing.h"
#include "core/vec.h"

namespace svgf {

// Steps of the gloss (guides.h), from 0 to this, that two bits hold.
constexpr int gloss_steps = 3;

// A frame's geometry: one image or several, in one piece of memory.
struct FrameSize {
    int width = 0, height = 0;

    SVGF_HD bool contains(int x, int y) const { return x >= 0 && x < width && y >= 0 && y < height; }
    SVGF_HD int pixel(int x, int y) const { return y * width + x; }
    // Inside, for any x and y.
    SVGF_HD int nearest_pixel(int x, int y) const {
        return pixel(clamp(x, 0, width - 1), clamp(y, 0, height - 1));
    }
};

struct FloatStorage {
    using MomentsValue = Vec2;
    static constexpr bool holds_any_bits = true;  // NaN, infinities and negative numbers too
    static constexpr int guide_bytes = 24, gradient_bytes = 8, length_bytes = 4, color_bytes = 16, moments_bytes = 8;

    struct Guides : FrameSize {
        Guides() = default;
        Guides(void* memory, int width, int height)
            : FrameSize{width, height}, normal_depth_(static_cast<Vec4*>(memory)),
              object_id_(reinterpret_cast<int32_t*>(normal_depth_ + size_t(width) * height)),
              length_(reinterpret_cast<float*>(object_id_ + size_t(width) * height)) {}

        using Texel = Vec4;
        SVGF_HD explicit operator bool() const { return normal_depth_ != nullptr; }
        SVGF_HD Texel fetch(int pixel) const { return normal_depth_[pixel]; }
        SVGF_HD static Vec4 normal_depth(const Texel& texel) { return texel; }
        SVGF_HD Vec4 normal_depth(int pixel) const { return normal_depth_[pixel]; }
        SVGF_HD float depth(int pixel) const { return normal_depth_[pixel].w; }
        // Normal and depth.
        SVGF_HD Vec4 read(int pixel, int32_t& object_id) const {
            object_id = object_id_[pixel];
            return normal_depth_[pixel];
        }
        SVGF_HD int32_t object_id(int pixel) const { return object_id_[pixel]; }
        // Frames in the history.
        SVGF_HD float length(int pixel) const { return length_[pixel]; }

        SVGF_HD void store(int pixel, Vec4 normal_depth, int32_t object_id) const {
            normal_depth_[pixel] = normal_depth;
            object_id_[pixel] = object_id;
        }
        SVGF_HD void store_length(int pixel, float length) const { length_[pixel] = length; }
        // Another image's, but for its frames.
        SVGF_HD void store(int pixel, const Guides& other, int other_pixel) const {
            store(pixel, other.normal_depth_[other_pixel], other.object_id_[other_pixel]);
        }

        // What may be compared with object_id().
        SVGF_HD static int32_t stored_id(int32_t object_id) { return object_id; }

    private:
        Vec4* normal_depth_ = nullptr;
        int32_t* object_id_ = nullptr;
        float* length_ = nullptr;
    };

    struct Gradients {
        Vec2* texels = nullptr;

        Gradients() = default;
        Gradients(void* memory) : texels(static_cast<Vec2*>(memory)) {}
        using Texel = Vec2;
        SVGF_HD Texel fetch(int pixel) const { return texels[pixel]; }
        SVGF_HD static Vec2 unpack(const Texel& texel) { return texel; }
        SVGF_HD Vec2 operator[](int pixel) const { return texels[pixel]; }
        SVGF_HD void store(int pixel, Vec2 gradient) const { texels[pixel] = gradient; }
    };

    // rgb, variance of luminance
    struct Color {
        Vec4* texels = nullptr;

        Color() = default;
        Color(void* memory) : texels(static_cast<Vec4*>(memory)) {}
        using Texel = Vec4;
        SVGF_HD Texel fetch(int pixel) const { return texels[pixel]; }
        SVGF_HD static Vec4 unpack(const Texel& texel) { return texel; }
        SVGF_HD Vec4 operator[](int pixel) const { return texels[pixel]; }
        SVGF_HD float variance(int pixel) const { return texels[pixel].w; }
        SVGF_HD void store(int pixel, Vec4 color) const { texels[pixel] = color; }
        SVGF_HD void store_variance(int pixel, float variance) const { texels[pixel].w = variance; }
        // texel: what is there.
        SVGF_HD void store_variance(int pixel, const Texel&, float variance) const { store_variance(pixel, variance); }
    };

    // mean, variance of luminance over time
    struct Moments {
        Vec2* texels = nullptr;

        Moments() = default;
        Moments(void* memory) : texels(static_cast<Vec2*>(memory)) {}
        SVGF_HD Vec2 operator[](int pixel) const { return texels[pixel]; }
        SVGF_HD void store(int pixel, Vec2 moments) const { texels[pixel] = moments; }
    };
};

struct PackedStorage {
    using MomentsValue = Vec4;
    // Normal 2 x 12 bits, depth 24 (7 of exponent, 17 of mantissa: good to 4e-6), and the object id, hashed to 16: 0
    // stays 0 and nothing else becomes it.
    struct alignas(8) Guide {
        uint32_t normal_id;  // id's lower byte in the uppermost
        uint32_t depth_id;   // id's upper byte in the uppermost
    };
    static constexpr bool holds_any_bits = false;  // every pattern of bits is a number in range
    static constexpr int guide_bytes = sizeof(Guide), gradient_bytes = 4;
    static constexpr int color_bytes = sizeof(PackedColor), moments_bytes = 4;

    struct Guides : FrameSize {
        Guides() = default;
        Guides(void* memory, int width, int height)
            : FrameSize{width, height}, texels_(static_cast<Guide*>(memory)) {}

        using Texel = Guide;
        SVGF_HD explicit operator bool() const { return texels_ != nullptr; }
        SVGF_HD Texel fetch(int pixel) const { return texels_[pixel]; }
        SVGF_HD static Vec4 normal_depth(const Texel& texel) {
            const Vec3 n = decode_normal<12>(texel.normal_id);
            return {n.x, n.y, n.z, decode_positive<17>(texel.depth_id & 0xffffffu)};
        }
        SVGF_HD Vec4 normal_depth(int pixel) const { return normal_depth(fetch(pixel)); }
        SVGF_HD float depth(int pixel) const { return decode_positive<17>(texels_[pixel].depth_id & 0xffffffu); }
        SVGF_HD int32_t object_id(int pixel) const { return object_id(fetch(pixel)); }
        SVGF_HD static int32_t object_id(const Texel& texel) {
            return int32_t(texel.normal_id >> 24 | texel.depth_id >> 24 << 8);
        }
        // Normal and depth.
        SVGF_HD Vec4 read(int pixel, int32_t& object_id) const {
            const Texel texel = fetch(pixel);
            object_id = Guides::object_id(texel);
            return normal_depth(texel);
        }

        SVGF_HD void store(int pixel, Vec4 normal_depth, int32_t object_id) const {
            const uint32_t id = uint32_t(stored_id(object_id));
            const float depth = id ? normal_depth.w : largest_float;
            texels_[pixel] = {encode_normal<12>(normal_depth.xyz()) | id << 24,
                              encode_positive<17>(depth) | id >> 8 << 24};
        }
        // Another image's.
        SVGF_HD void store(int pixel, const Guides& other, int other_pixel) const {
            texels_[pixel] = other.texels_[other_pixel];
        }

        // What may be compared with object_id().
        SVGF_HD static int32_t stored_id(int32_t object_id) {
            if (object_id == 0) return 0;
            const uint32_t hash = uint32_t(object_id) * 0x9e3779b1u >> 16;
            return hash ? int32_t(hash) : 1;
        }

    private:
        Guide* texels_ = nullptr;
    };

    // 2 x 16 bits: sign, 7 of exponent, 7 of mantissa; a bit of the gloss.
    struct Gradients {
        uint32_t* texels = nullptr;

        Gradients() = default;
        Gradients(void* memory) : texels(static_cast<uint32_t*>(memory)) {}
        using Texel = uint32_t;
        SVGF_HD Texel fetch(int pixel) const { return texels[pixel]; }
        SVGF_HD static Vec2 unpack(Texel texel) { return {decode_slope(texel), decode_slope(texel >> 16)}; }
        SVGF_HD static float gloss(Texel texel) {
            return float((texel & 1u) | (texel >> 15 & 2u)) * (1.0f / float(gloss_steps));
        }
        SVGF_HD Vec2 operator[](int pixel) const { return unpack(texels[pixel]); }
        SVGF_HD void store(int pixel, Vec2 gradient, float gloss = 1.0f) const {
            const uint32_t step = uint32_t(gloss * float(gloss_steps) + 0.5f);
            texels[pixel] = encode_slope(gradient.x) | (step & 1u) | (encode_slope(gradient.y) | step >> 1) << 16;
        }

    private:
        // The lowest of the 16 bits is left to the gloss.
        SVGF_HD static uint32_t encode_slope(float slope) {
            return encode_positive<7>(std::fabs(slope)) << 1 | (slope < 0.0f ? 0x8000u : 0u);
        }
        SVGF_HD static float decode_slope(uint32_t code) {
            const float slope = decode_positive<7>(code >> 1 & 0x3fffu);
            return code & 0x8000u ? -slope : slope;
        }
    };

    struct Color {
        PackedColor* texels = nullptr;

        Color() = default;
        Color(void* memory) : texels(static_cast<PackedColor*>(memory)) {}
        using Texel = PackedColor;
        SVGF_HD Texel fetch(int pixel) const { return texels[pixel]; }
        SVGF_HD static Vec4 unpack(const Texel& texel) {
            const Vec3 c = decode_color(texel);
            return {c.x, c.y, c.z, square(decode_deviation(texel))};
        }
        SVGF_HD Vec4 operator[](int pixel) const { return unpack(texels[pixel]); }
        SVGF_HD float variance(int pixel) const { return square(decode_deviation(texels[pixel])); }
        SVGF_HD void store(int pixel, Vec4 color) const {
            texels[pixel] = encode_color(color.xyz(), fast_sqrt(color.w));
        }
        SVGF_HD void store_variance(int pixel, float variance) const {
            store_variance(pixel, texels[pixel], variance);
        }
        // texel: what is there.
        SVGF_HD void store_variance(int pixel, const Texel& texel, float variance) const {
            texels[pixel].high = (texel.high & 0x1ffffu) | encode_positive<8>(fast_sqrt(variance)) << 17;
        }
    };

    // What svgf+ knows of a signal's history: frames in 12 bits, 9 of precision; variance of a sample in 12 bits, 5 of
    // precision and all of float's exponent; drift in [-4, 4) in 7 bits; a bit for light that has changed. Frames and
    // variance are rounded at random, so that a long mean has no bias: rounding to nearest would lose the many small
    // steps down and keep the few large ones up. (It must be the variance: a deviation without bias, squared, has one.)
    struct Moments {
        uint32_t* texels = nullptr;

        Moments() = default;
        Moments(void* memory) : texels(static_cast<uint32_t*>(memory)) {}
        // frames, variance, drift, 1 if the light has changed
        SVGF_HD Vec4 operator[](int pixel) const {
            const uint32_t packed = texels[pixel];
            return {float_from_bits(((packed & 0xfffu) << 15) + (127u << 23)) - 1.0f,
                    float_from_bits((packed >> 12 & 0xfffu) << 19), drift(pixel), has_changed(pixel) ? 1.0f : 0.0f};
        }
        static constexpr float drift_step = 1.0f / 16.0f;
        SVGF_HD int drift_steps(int pixel) const { return int32_t(texels[pixel]) >> 25; }
        SVGF_HD float drift(int pixel) const { return float(drift_steps(pixel)) * drift_step; }
        SVGF_HD bool has_changed(int pixel) const { return texels[pixel] >> 24 & 1u; }
        SVGF_HD void store(int pixel, Vec4 moments) const {
            uint32_t hash = bits_of(moments.y) ^ (bits_of(moments.z) + uint32_t(pixel)) * 0x9e3779b1u;
            hash = (hash ^ hash >> 15) * 0x85ebca6bu;
            hash ^= hash >> 13;
            const uint32_t frames = bits_of(min(moments.x, 65000.0f) + 1.0f) + (hash & 0x7fffu) - (127u << 23);
            const int drift = int(std::floor(clamp(moments.z, -4.0f, 3.9f) / drift_step + 0.5f));
            const uint32_t variance = bits_of(min(moments.y, 0x1p126f)) + (hash >> 13);
            texels[pixel] = frames >> 15 | variance >> 19 << 12 | (moments.w > 0.5f ? 1u << 24 : 0u) |
                            uint32_t(drift) << 25;
        }
    };
};

}  // namespace svgf
