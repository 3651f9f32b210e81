// SPDX-License-Identifier: Apache-2.0
// Arrays between Python and a device. Images come in as numpy arrays or, on CUDA, as anything on the same GPU that
// speaks DLPack; they go out as numpy arrays on the CPU and as DeviceImage, which speaks DLPack, on CUDA.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "denoise/denoiser.h"
#include "device/device.h"

namespace svgf {

namespace nb = nanobind;

#if defined(SVGF_CUDA)
inline constexpr int device_type = nb::device::cuda::value;
#else
inline constexpr int device_type = nb::device::cpu::value;
#endif

#if defined(SVGF_CUDA)
// An image that stays on the GPU. It goes from the tracer to the denoiser as it is, and to other libraries by DLPack.
struct DeviceImage {
    std::variant<Buffer<float>, Buffer<int32_t>> pixels;
    int height, width, channels;

    const void* data() const {
        return std::visit([](const auto& buffer) { return static_cast<const void*>(buffer.data()); }, pixels);
    }
};

// The capsule keeps the image alive, and with it the device. stream: that of the reader, as the array API's __dlpack__
// numbers them (1 the legacy default one, 2 that of the thread, -1: no order wanted); it is made to wait for the image.
inline nb::object dlpack_capsule(nb::handle self, std::optional<intptr_t> stream, nb::kwargs) {
    auto& image = nb::cast<DeviceImage&>(self);
    if (stream.value_or(1) != -1)
        std::visit([&](auto& buffer) { buffer.device().let_wait(uintptr_t(stream.value_or(1))); }, image.pixels);
    const size_t shape[3] = {size_t(image.height), size_t(image.width), size_t(image.channels)};
    return std::visit(
        [&](auto& buffer) {
            using Value = std::remove_pointer_t<decltype(buffer.data())>;
            nb::ndarray<> array(buffer.data(), image.channels == 1 ? 2 : 3, shape, self, nullptr, nb::dtype<Value>(),
                                device_type, buffer.device().index());
            // Older versions of nanobind hand out the capsule itself.
            nb::object exported = nb::cast(array);
            return nb::hasattr(exported, "__dlpack__") ? nb::object(exported.attr("__dlpack__")()) : exported;
        },
        image.pixels);
}
#endif

// --- Arrays in -------------------------------------------------------------------------------------------------------

template <class T>
using HostArray = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

template <class T>
std::span<const T> span_of(const HostArray<T>& array) {
    return {array.data(), array.size()};
}

template <class T>
std::span<const T> span_of(const std::optional<HostArray<T>>& array) {
    return array ? span_of(*array) : std::span<const T>();
}

template <size_t Size>
std::span<const float, Size> fixed_span(const HostArray<float>& array, const char* name) {
    if (array.size() != Size)
        throw InputError(std::string(name) + " has " + std::to_string(array.size()) + " values instead of " +
                         std::to_string(Size) + ".");
    return std::span<const float, Size>(array.data(), Size);
}

// The images of a dictionary, on the device: those of the host are uploaded, those of the device are used as they are.
class ImageReader {
public:
    ImageReader(Device& device, const nb::dict& images, int width, int height)
        : device_(device), images_(images), width_(width), height_(height) {}

    ImageView operator()(const char* name) {
        if (!images_.contains(name)) return {};
        nb::object value = images_[name];
        if (value.is_none()) return {};
#if defined(SVGF_CUDA)
        if (nb::isinstance<DeviceImage>(value)) {
            const auto& image = nb::cast<DeviceImage&>(value);
            if (image.height != height_ || image.width != width_) throw InputError(wrong_size(name));
            return {image.data(), image.channels};
        }
#endif
        const bool ids = std::string_view(name) == "object_id";
        nb::ndarray<nb::ro, nb::c_contig> array;
        if (!nb::try_cast(value, array))
            throw InputError("Image \"" + std::string(name) + "\" is not a C-contiguous array.");
        if (array.dtype() != (ids ? nb::dtype<int32_t>() : nb::dtype<float>()))
            throw InputError("Image \"" + std::string(name) + "\" must be " + (ids ? "int32." : "float32."));
        const bool is_image = array.ndim() == 2 || array.ndim() == 3;
        if (!is_image || array.shape(0) != size_t(height_) || array.shape(1) != size_t(width_))
            throw InputError(wrong_size(name));
        const int channels = array.ndim() == 3 ? int(array.shape(2)) : 1;
        kept_.push_back(array);
        if (array.device_type() == device_type) return {array.data(), channels};
        if (array.device_type() != nb::device::cpu::value)
            throw InputError("Image \"" + std::string(name) + "\" is on a device that this denoiser cannot read.");
        uploads_.emplace_back(
            device_, std::span(static_cast<const std::byte*>(array.data()), array.nbytes()), "an input image");
        return {uploads_.back().data(), channels};
    }

private:
    std::string wrong_size(const char* name) const {
        return "Image \"" + std::string(name) + "\" does not have " + std::to_string(height_) + " rows and " +
               std::to_string(width_) + " columns.";
    }

    Device& device_;
    const nb::dict& images_;
    int width_, height_;
    std::vector<nb::ndarray<nb::ro, nb::c_contig>> kept_;
    std::vector<Buffer<std::byte>> uploads_;
};

// --- Arrays out ------------------------------------------------------------------------------------------------------

template <class T>
nb::object numpy_image(std::vector<T>&& values, size_t dimensions, const size_t* shape) {
    auto* owner = new std::vector<T>(std::move(values));
    nb::capsule capsule(owner, [](void* pointer) noexcept { delete static_cast<std::vector<T>*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, T>(owner->data(), dimensions, shape, capsule));
}

template <class T>
nb::object give_image(Buffer<T>&& buffer, int width, int height, int channels) {
#if defined(SVGF_CUDA)
    return nb::cast(DeviceImage{std::move(buffer), height, width, channels}, nb::rv_policy::move);
#else
    auto* owner = new Buffer<T>(std::move(buffer));
    nb::capsule capsule(owner, [](void* pointer) noexcept { delete static_cast<Buffer<T>*>(pointer); });
    const size_t shape[3] = {size_t(height), size_t(width), size_t(channels)};
    return nb::cast(nb::ndarray<nb::numpy, T>(owner->data(), channels == 1 ? 2 : 3, shape, capsule));
#endif
}

inline nb::object to_numpy(Device& device, nb::object image) {
#if defined(SVGF_CUDA)
    if (nb::isinstance<DeviceImage>(image)) {
        const auto& source = nb::cast<DeviceImage&>(image);
        const size_t shape[3] = {size_t(source.height), size_t(source.width), size_t(source.channels)};
        return std::visit(
            [&](const auto& pixels) {
                using Value = std::remove_const_t<std::remove_pointer_t<decltype(pixels.data())>>;
                auto* owner = new std::shared_ptr<void>(device.host_memory(pixels.bytes()));
                nb::capsule capsule(
                    owner, [](void* memory) noexcept { delete static_cast<std::shared_ptr<void>*>(memory); });
                {
                    nb::gil_scoped_release release;
                    device.download(owner->get(), pixels.data(), pixels.bytes());
                }
                const size_t dimensions = source.channels == 1 ? 2 : 3;
                return nb::cast(nb::ndarray<nb::numpy, Value>(owner->get(), dimensions, shape, capsule));
            },
            source.pixels);
    }
#endif
    (void)device;
    return image;
}

// A numpy image, float32 or int32 [H, W] or [H, W, C], as this device's tracers and denoisers return theirs.
inline nb::object upload(Device& device, nb::object image) {
#if defined(SVGF_CUDA)
    const auto convert = [&]<class Value>(const HostArray<Value>& array) {
        if (array.ndim() < 2 || array.ndim() > 3) throw InputError("An image has two or three dimensions.");
        return give_image(Buffer<Value>(device, span_of(array), "an input image"), int(array.shape(1)),
                          int(array.shape(0)), array.ndim() == 3 ? int(array.shape(2)) : 1);
    };
    HostArray<int32_t> ids;
    if (nb::try_cast(image, ids, false)) return convert(ids);
    return convert(nb::cast<HostArray<float>>(image));
#else
    (void)device;
    return image;
#endif
}

}  // namespace svgf
