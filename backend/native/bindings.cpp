// SPDX-License-Identifier: Apache-2.0
// The Python module of one device (see CMakeLists.txt). It converts arrays (bindings_arrays.h) and errors, and nothing
// else. The GIL is released while native code works.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "bindings_arrays.h"
#include "denoise/denoiser.h"
#include "device/bandwidth.h"
#include "device/device.h"
#include "device/display.h"
#include "trace/tracer.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace svgf {
namespace {

// --- Errors ----------------------------------------------------------------------------------------------------------

void raise(const char* type, const std::string& message, const std::string& hint = "", const char* stage = nullptr) {
    const nb::object error_class = nb::module_::import_("svgf.errors").attr(type);
    const nb::object error = stage ? error_class(message, hint, stage) : error_class(message, hint);
    PyErr_SetObject(error_class.ptr(), error.ptr());
}

void translate_error(const std::exception_ptr& error, void*) {
    try {
        std::rethrow_exception(error);
    } catch (const OutOfMemory& e) {
        raise("OutOfMemory", e.what(), e.hint, e.stage.c_str());
    } catch (const DeviceError& e) {
        raise("DeviceError", e.what(), e.hint, e.stage.c_str());
    } catch (const Interrupted& e) {
        raise("Interrupted", e.what());
    } catch (const InputError& e) {
        raise("InputError", e.what());
    } catch (const std::invalid_argument& e) {
        raise("InputError", e.what());
    } catch (const std::bad_alloc&) {
        raise("OutOfMemory", "The computer is out of memory.", "Close other programs, or render smaller.", "");
    }
}

// --- Tracer ----------------------------------------------------------------------------------------------------------

std::shared_ptr<Mesh> make_mesh(Device& device, HostArray<float> positions, HostArray<int32_t> triangles,
                                HostArray<float> normals, std::optional<HostArray<float>> uvs,
                                HostArray<int32_t> material_slots, std::optional<HostArray<float>> previous_positions,
                                std::optional<HostArray<float>> tangents, int tangent_layer) {
    const Mesh::Arrays arrays{span_of(positions),          span_of(triangles), span_of(normals), span_of(uvs),
                              span_of(material_slots),     span_of(previous_positions),
                              span_of(tangents),           tangent_layer};
    nb::gil_scoped_release release;
    return std::make_shared<Mesh>(device, arrays);
}

bool refit_mesh(Mesh& mesh, Device& device, HostArray<float> positions, HostArray<float> normals,
                HostArray<float> previous_positions, std::optional<HostArray<float>> tangents) {
    const Mesh::Arrays arrays{.positions = span_of(positions), .triangles = {}, .normals = span_of(normals), .uvs = {},
                              .material_slots = {}, .previous_positions = span_of(previous_positions),
                              .tangents = span_of(tangents)};
    nb::gil_scoped_release release;
    return mesh.refit(device, arrays);
}

std::shared_ptr<Texture> make_texture(Device& device, nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu> pixels,
                                      bool srgb, int interpolation, int extension, bool associated_alpha) {
    if (pixels.ndim() != 3 || pixels.shape(2) != 4) throw InputError("A texture's pixels must be [H, W, 4].");
    const int height = int(pixels.shape(0)), width = int(pixels.shape(1));
    if (pixels.dtype() == nb::dtype<uint8_t>())
        return std::make_shared<Texture>(device, std::span(static_cast<const uint8_t*>(pixels.data()), pixels.size()),
                                         width, height, srgb, interpolation, extension, associated_alpha);
    if (pixels.dtype() == nb::dtype<float>())
        return std::make_shared<Texture>(device, std::span(static_cast<const float*>(pixels.data()), pixels.size()),
                                         width, height, interpolation, extension, associated_alpha);
    throw InputError("A texture's pixels must be uint8 or float32.");
}

void set_instances(Tracer& tracer, std::vector<std::shared_ptr<Mesh>> meshes, HostArray<int32_t> instance_mesh,
                   HostArray<float> object_to_world, HostArray<float> world_to_object,
                   HostArray<float> previous_object_to_world, HostArray<int32_t> object_id,
                   HostArray<int32_t> material_start, HostArray<int32_t> material_table, HostArray<uint8_t> visibility,
                   HostArray<int32_t> emitter, HostArray<float> terminator_offset) {
    const Tracer::Instances instances{span_of(instance_mesh),   span_of(object_to_world), span_of(world_to_object),
                                      span_of(previous_object_to_world), span_of(object_id), span_of(material_start),
                                      span_of(material_table), span_of(visibility), span_of(emitter),
                                      span_of(terminator_offset)};
    nb::gil_scoped_release release;
    tracer.set_instances(std::move(meshes), instances);
}

void set_lights(Tracer& tracer, HostArray<int32_t> kind, HostArray<float> data, HostArray<uint8_t> visibility,
                HostArray<float> probability, HostArray<float> cdf, HostArray<float> tree,
                HostArray<int32_t> light_of_leaf, HostArray<int32_t> emitters, HostArray<int32_t> light_of_triangle,
                HostArray<int32_t> emission_map, HostArray<float> emission_maps) {
    tracer.set_lights({span_of(kind), span_of(data), span_of(visibility), span_of(probability), span_of(cdf),
                       span_of(tree), span_of(light_of_leaf), span_of(emitters), span_of(light_of_triangle),
                       span_of(emission_map), span_of(emission_maps)});
}

void set_world(Tracer& tracer, HostArray<float> radiance, uint32_t visibility, int texture, int light,
               HostArray<float> to_environment, HostArray<float> row_cdf, HostArray<float> column_cdf,
               HostArray<float> backdrop_radiance, int backdrop_texture) {
    const auto color = fixed_span<3>(radiance, "world_radiance");
    const auto backdrop = fixed_span<3>(backdrop_radiance, "backdrop_radiance");
    const auto rotation = fixed_span<9>(to_environment, "world_to_environment");
    Tracer::World world{.radiance = {color[0], color[1], color[2]},
                        .visibility = visibility,
                        .texture = texture,
                        .backdrop_radiance = {backdrop[0], backdrop[1], backdrop[2]},
                        .backdrop_texture = backdrop_texture,
                        .light = light,
                        .row_cdf = span_of(row_cdf),
                        .column_cdf = span_of(column_cdf)};
    std::copy(rotation.begin(), rotation.end(), world.to_environment.begin());
    world.rows = std::max(int(row_cdf.size()) - 1, 0);
    world.columns = world.rows ? int(column_cdf.size()) / world.rows - 1 : 0;
    tracer.set_world(world);
}

void set_camera(Tracer& tracer, HostArray<float> camera_to_world, HostArray<float> previous_camera_to_world,
                HostArray<float> window, HostArray<float> previous_window, HostArray<float> clip, HostArray<float> lens,
                HostArray<float> previous_lens) {
    tracer.set_camera({fixed_span<12>(camera_to_world, "camera_to_world"),
                       fixed_span<12>(previous_camera_to_world, "previous_camera_to_world"),
                       fixed_span<4>(window, "window"), fixed_span<4>(previous_window, "previous_window"),
                       fixed_span<2>(clip, "clip"), fixed_span<6>(lens, "lens"),
                       fixed_span<6>(previous_lens, "previous_lens")});
}

// values: the fields of svgf.LightPaths in their order; none: no limits.
LightPaths read_light_paths(int bounces, const std::vector<double>& values) {
    if (values.empty()) return {.bounces = bounces};
    if (values.size() != 9) throw InputError("light_paths must have 9 values.");
    return {bounces, int(values[0]), int(values[1]), int(values[2]), int(values[3]), values[4] != 0, values[5] != 0,
            float(values[6]), float(values[7]), float(values[8])};
}

template <class Choice>
Choice choose(const std::string& value, const char* what,
              std::initializer_list<std::pair<const char*, Choice>> choices) {
    std::string names;
    for (const auto& [name, choice] : choices) {
        if (value == name) return choice;
        names += names.empty() ? name : std::string(", ") + name;
    }
    throw InputError("There is no " + std::string(what) + " \"" + value + "\"; choose one of " + names + ".");
}

nb::dict give_images(std::vector<Image>&& images, int width, int height) {
    nb::dict result;
    for (auto& image : images)
        result[image.name.c_str()] = std::visit(
            [&](auto& pixels) { return give_image(std::move(pixels), width, height, image.channels); }, image.pixels);
    return result;
}

nb::dict trace(Tracer& tracer, int width, int height, uint32_t sample, int samples, uint32_t seed, int bounces,
               uint32_t effects, const std::string& pixel_filter, const std::string& signals,
               const std::vector<double>& light_paths, bool transparent_film, uint32_t kernel) {
    const Tracer::Frame frame{
        .width = width,
        .height = height,
        .sample = sample,
        .samples = samples,
        .seed = seed,
        .light_paths = read_light_paths(bounces, light_paths),
        .transparent_film = transparent_film,
        .effects = effects,
        .kernel = kernel,
        .pixel_filter = choose<PixelFilter>(pixel_filter, "pixel filter",
                                            {{"box", PixelFilter::box}, {"center", PixelFilter::center}}),
        .signals = choose<Signals>(signals, "split into signals",
                                   {{"diffuse_specular", Signals::diffuse_specular},
                                    {"direct_indirect", Signals::direct_indirect}}),
    };
    std::vector<Image> images;
    {
        nb::gil_scoped_release release;
        images = tracer.trace(frame);
    }
    return give_images(std::move(images), width, height);
}

nb::dict cast_rays(Tracer& tracer, HostArray<float> rays, bool any_hit) {
    if (rays.ndim() != 3 || rays.shape(2) != 8) throw InputError("Rays must be [H, W, 8].");
    const int height = int(rays.shape(0)), width = int(rays.shape(1));
    std::vector<Image> images;
    {
        nb::gil_scoped_release release;
        images = tracer.cast(span_of(rays), width, height, any_hit);
    }
    return give_images(std::move(images), width, height);
}

// --- Denoiser --------------------------------------------------------------------------------------------------------

DenoiseSettings read_settings(const nb::dict& values) {
    DenoiseSettings settings;
    for (const auto& [key, value] : values) {
        const auto name = nb::cast<std::string>(key);
        if (!set_denoise_setting(settings, name, nb::cast<double>(value)))
            throw InputError("Denoiser setting \"" + name + "\" is unknown or out of range.");
    }
    return settings;
}

Vec4 read_window(const nb::dict& images) {
    if (!images.contains("window")) return DenoiseInputs::default_window;
    const auto window = nb::cast<std::vector<double>>(images["window"].attr("tolist")());
    if (window.size() != 4) throw InputError("window must hold left, right, bottom and top.");
    return {float(window[0]), float(window[1]), float(window[2]), float(window[3])};
}

nb::dict denoise(Denoiser& denoiser, const nb::dict& images, bool reset, std::optional<uintptr_t> stream,
                 bool diagnostics, bool unchanged, bool interactive) {
    Device& device = denoiser.device();
    const int width = denoiser.width(), height = denoiser.height();
    const size_t pixels = size_t(width) * height;

    ImageReader reader(device, images, width, height);
    DenoiseInputs inputs = gather_denoise_inputs([&](const char* name) { return reader(name); });
    inputs.window = read_window(images);
    inputs.is_unchanged = unchanged;
    inputs.is_interactive = interactive;
    denoiser.prepare(inputs.signals);  // on the device's own stream, which outlives the caller's
    const Device::StreamScope scope(device, stream);
    Buffer<float> color(device, pixels * 3, "the denoised image");
    Buffer<float> variance(device, pixels, "the variance image"), history_length(device, pixels, "the history image");
    std::vector<Buffer<float>> told;
    DenoiseDiagnostics to_tell;
    const std::pair<const char*, float**> tellable[] = {{"motion_error", &to_tell.motion_error},
                                                        {"reset_reason", &to_tell.reset_reason},
                                                        {"repaired_values", &to_tell.repaired_values},
                                                        {"suppressed_light", &to_tell.suppressed_light}};
    if (diagnostics)
        for (const auto& [name, image] : tellable) *image = told.emplace_back(device, pixels, name).data();
    {
        nb::gil_scoped_release release;
        denoiser.denoise(inputs, {color.data(), variance.data(), history_length.data()}, reset,
                         diagnostics ? &to_tell : nullptr);
    }
    nb::dict result;
    for (size_t i = 0; i < told.size(); ++i)
        result[tellable[i].first] = give_image(std::move(told[i]), width, height, 1);
    result["color"] = give_image(std::move(color), width, height, 3);
    result["variance"] = give_image(std::move(variance), width, height, 1);
    result["history_length"] = give_image(std::move(history_length), width, height, 1);
    return result;
}

nb::dict host_images(const Denoiser& denoiser, HostImages&& images) {
    nb::dict result;
    for (auto& [name, image] : images) {
        const size_t shape[3] = {size_t(denoiser.height()), size_t(denoiser.width()), size_t(image.channels)};
        result[name.c_str()] = numpy_image(std::move(image.values), image.channels == 1 ? 2 : 3, shape);
    }
    return result;
}

// arrays and result: name -> float32 [H, W] or [H, W, C].
nb::dict run_stage(Denoiser& denoiser, const std::string& stage, const nb::dict& arrays, int level) {
    HostImages images;
    for (const auto& [key, value] : arrays) {
        const auto array = nb::cast<HostArray<float>>(value);
        images[nb::cast<std::string>(key)] = {array.ndim() == 3 ? int(array.shape(2)) : 1,
                                              {array.data(), array.data() + array.size()}};
    }
    return host_images(denoiser, denoiser.run_stage(stage, images, level));
}

nb::list denoise_settings() {
    nb::list table;
    for (const SettingInfo& info : denoise_setting_table) {
        nb::dict row;
        row["name"] = std::string(info.name);
        row["type"] = std::string(info.type);
        row["default"] = info.fallback;
        row["minimum"] = info.minimum;
        row["maximum"] = info.maximum;
        row["unit"] = std::string(info.unit);
        row["symbol"] = std::string(info.symbol);
        row["meaning"] = std::string(info.meaning);
        table.append(row);
    }
    return table;
}

// --- Display ---------------------------------------------------------------------------------------------------------

#if !defined(SVGF_CUDA)
using StridedImage = nb::ndarray<const float, nb::ndim<3>, nb::device::cpu>;
using StridedPixels = nb::ndarray<float, nb::ndim<3>, nb::device::cpu>;

template <class T, class Array>
Pixels<T> pixels_of(const Array& array) {
    if (array.shape(2) > 1 && array.stride(2) != 1) throw InputError("The channels of a pixel must lie side by side.");
    return {array.data(), ptrdiff_t(array.stride(0)), ptrdiff_t(array.stride(1))};
}

void write_display_array(const StridedPixels& rgba, const StridedImage& image, float largest) {
    const size_t height = image.shape(0), width = image.shape(1), channels = image.shape(2);
    if (rgba.shape(0) != height || rgba.shape(1) != width || rgba.shape(2) != 4 || (channels != 1 && channels != 3))
        throw InputError("An image [H, W, 1 or 3] is displayed as pixels [H, W, 4].");
    const auto in = pixels_of<const float>(image);
    const auto out = pixels_of<float>(rgba);
    nb::gil_scoped_release release;
    write_display(in, int(height), int(width), int(channels), largest, out);
}
#endif

// --- Module ----------------------------------------------------------------------------------------------------------

void bind_device(nb::module_& module) {
    module.def("list_devices", [] {
        std::vector<std::tuple<std::string, size_t, std::string>> devices;
        for (const auto& info : list_devices()) devices.emplace_back(info.name, info.memory_bytes, info.reason);
        return devices;
    }, "(name, memory in bytes or 0, reason why it cannot be used or '') of each device.");
#if !defined(SVGF_CUDA)
    module.def("processor_has_avx2", [] {
#if defined(__x86_64__) && defined(__GNUC__)
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
        return false;
#endif
    });
    module.attr("has_avx2_build") = bool(SVGF_HAS_AVX2_BUILD);
    module.def("write_display", &write_display_array, "rgba"_a.noconvert(), "image"_a, "largest"_a);
#endif

    nb::class_<Device>(module, "Device")
        .def(nb::new_([](int index) { return std::make_shared<Device>(index); }), "index"_a = 0)
        .def("take_timings", [](Device& device, bool by_launch) {
            std::vector<std::pair<std::string, double>> timings;
            {
                nb::gil_scoped_release release;
                timings = device.take_timings(by_launch);
            }
            nb::dict result;
            for (const auto& [name, milliseconds] : timings) result[name.c_str()] = milliseconds;
            return result;
        }, "by_launch"_a = false)
        .def("synchronize", &Device::synchronize, nb::call_guard<nb::gil_scoped_release>())
        .def("interrupt", &Device::interrupt)
        .def("clear_interrupt", &Device::clear_interrupt)
        .def("to_numpy", &to_numpy, "image"_a)
        .def("upload", &upload, "image"_a)
        .def("copy_bandwidth", &measure_copy_bandwidth, "bytes"_a, "repetitions"_a,
             nb::call_guard<nb::gil_scoped_release>());

#if defined(SVGF_CUDA)
    nb::class_<DeviceImage>(module, "DeviceImage")
        .def("__dlpack__", &dlpack_capsule, nb::kw_only(), "stream"_a = nb::none(), "kwargs"_a)
        .def("__dlpack_device__", [](const DeviceImage& image) {
            return std::visit([](const auto& buffer) { return std::pair(device_type, buffer.device().index()); },
                              image.pixels);
        })
        .def_prop_ro("shape", [](const DeviceImage& image) {
            return image.channels == 1 ? nb::object(nb::make_tuple(image.height, image.width))
                                       : nb::object(nb::make_tuple(image.height, image.width, image.channels));
        });
#endif
}

void bind_tracer(nb::module_& module) {
    module.def("kernels", [] {
        std::vector<uint32_t> kernels;
        for (const Effects kernel : Tracer::kernels()) kernels.push_back(uint32_t(kernel));
        return kernels;
    }, "Bits of the effects that each compiled kernel simulates, from the cheapest on: the first that covers a frame "
       "runs.");

    nb::class_<Mesh>(module, "Mesh")
        .def(nb::new_(&make_mesh), "device"_a, "positions"_a, "triangles"_a, "normals"_a,
             "uvs"_a.none(), "material_slots"_a, "previous_positions"_a.none(), "tangents"_a = nb::none(),
             "tangent_layer"_a = 0)
        .def("refit", &refit_mesh, "device"_a, "positions"_a, "normals"_a, "previous_positions"_a,
             "tangents"_a = nb::none())
        .def_prop_ro("bytes", &Mesh::bytes);

    nb::class_<Texture>(module, "Texture")
        .def(nb::new_(&make_texture), "device"_a, "pixels"_a, "srgb"_a, "interpolation"_a,
             "extension"_a, "associated_alpha"_a);

    // Tracer and Denoiser keep the device alive: it is used when they run, and by their buffers until they are gone.
    nb::class_<Tracer>(module, "Tracer").def(nb::init<Device&>(), nb::keep_alive<1, 2>(), "device"_a)
        .def("set_instances", &set_instances, "meshes"_a, "instance_mesh"_a, "object_to_world"_a, "world_to_object"_a,
             "previous_object_to_world"_a, "object_id"_a, "material_start"_a, "material_table"_a, "visibility"_a,
             "emitter"_a, "terminator_offset"_a)
        .def("set_materials", [](Tracer& tracer, HostArray<float> materials, HostArray<float> material_maps,
                                 std::vector<std::shared_ptr<Texture>> textures) {
            tracer.set_materials(span_of(materials), span_of(material_maps), std::move(textures));
        }, "materials"_a, "material_maps"_a, "textures"_a)
        .def("set_albedo_tables", [](Tracer& tracer, HostArray<float> tables) {
            tracer.set_albedo_tables(span_of(tables));
        }, "tables"_a)
        .def("set_lights", &set_lights, "light_kind"_a, "light_data"_a, "light_visibility"_a, "light_probability"_a,
             "light_cdf"_a, "light_tree"_a, "light_of_leaf"_a, "emitters"_a, "light_of_triangle"_a, "emission_map"_a,
             "emission_maps"_a)
        .def("set_world", &set_world, "radiance"_a, "visibility"_a, "texture"_a, "light"_a, "to_environment"_a,
             "row_cdf"_a, "column_cdf"_a, "backdrop_radiance"_a, "backdrop_texture"_a)
        .def("set_camera", &set_camera, "camera_to_world"_a, "previous_camera_to_world"_a, "window"_a,
             "previous_window"_a, "clip"_a, "lens"_a, "previous_lens"_a)
        .def("trace", &trace, "width"_a, "height"_a, "sample"_a, "samples"_a, "seed"_a, "bounces"_a, "effects"_a,
             "pixel_filter"_a, "signals"_a, "light_paths"_a = std::vector<double>{}, "transparent_film"_a = false,
             "kernel"_a = 0)
        .def("cast", &cast_rays, "rays"_a, "any_hit"_a);
}

void bind_denoiser(nb::module_& module) {
    module.def("reset_reasons", [] {
        nb::dict result;
        for (size_t i = 0; i < std::size(reset_reason_names); ++i)
            result[nb::str(reset_reason_names[i].data(), reset_reason_names[i].size())] = int(i);
        return result;
    }, "Names and values of ResetReason in denoise/denoiser.h.");
    module.def("denoise_settings", &denoise_settings, "The rows of SVGF_DENOISE_SETTINGS in denoise/settings.h.");

    nb::class_<Denoiser>(module, "Denoiser")
        .def("__init__", [](Denoiser* self, Device& device, int width, int height, const std::string& method_name,
                            const nb::dict& settings) {
            const auto method = denoise_method_from_name(method_name);
            if (!method) throw InputError("There is no denoising method \"" + method_name + "\".");
            new (self) Denoiser(device, width, height, *method, read_settings(settings));
        }, nb::keep_alive<1, 2>(), "device"_a, "width"_a, "height"_a, "method"_a, "settings"_a)
        .def("denoise", &denoise, "inputs"_a, "reset"_a, "stream"_a = nb::none(), "diagnostics"_a = false,
             "unchanged"_a = false, "interactive"_a = false)
        .def("resize", &Denoiser::resize, "width"_a, "height"_a, nb::call_guard<nb::gil_scoped_release>(),
             "The next frame is of another size; history goes on in it.")
        .def("history_images", [](Denoiser& denoiser) {
            return host_images(denoiser, denoiser.history_images());
        }, "What the next frame starts from.")
        .def("set_settings", [](Denoiser& denoiser, const nb::dict& settings) {
            denoiser.set_settings(read_settings(settings));
        }, "settings"_a)
        .def("stage", &run_stage, "name"_a, "arrays"_a, "level"_a = 0)
        .def("repaired", &Denoiser::repaired, nb::call_guard<nb::gil_scoped_release>())
        .def("fireflies", [](const Denoiser& denoiser) {
            const FireflyCount count = denoiser.fireflies();
            return std::pair(count.samples, double(count.light) / light_units);
        }, "Samples of the last frame that svgf+ scaled down, and the luminance over albedo that was cut, over all "
           "pixels.")
        .def("traffic", [](const Denoiser& denoiser) {
            nb::dict result;
            for (const auto& [stage, bytes] : denoiser.traffic()) result[stage.c_str()] = bytes;
            return result;
        }, "Bytes that each stage of the last frame had to move at least.")
        .def("buffers", [](const Denoiser& denoiser) {
            std::vector<std::pair<std::string, size_t>> buffers;
            for (const auto& info : denoiser.buffers()) buffers.emplace_back(info.name, info.bytes);
            return buffers;
        }, "(name, bytes) of each buffer that the denoiser holds between frames.");
}

}  // namespace
}  // namespace svgf

NB_MODULE(SVGF_MODULE, module) {
    using namespace svgf;
    nb::register_exception_translator(translate_error);
    // At exit objects may outlive the module, held by whoever made them; that is no news for a user's terminal.
    nb::set_leak_warnings(false);
    bind_device(module);
    bind_tracer(module);
    bind_denoiser(module);
}
