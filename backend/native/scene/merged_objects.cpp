// SPDX-License-Identifier: Apache-2.0
#include "scene/merged_objects.h"

#include <algorithm>
#include <cstddef>

#include "device/threads.h"

namespace svgf {
namespace {

// Triangles of the tree at most: it is built while an artist waits.
constexpr std::size_t most_triangles = std::size_t(1) << 22;
// How many times its size an object may lie from the world's origin. Beyond, the rounding of world coordinates would
// show in its shape.
constexpr float farthest = 256.0f;

bool is_same(const Mat34& a, const Mat34& b) {
    const auto same = [](const Vec4& p, const Vec4& q) {
        return p.x == q.x && p.y == q.y && p.z == q.z && p.w == q.w;
    };
    return same(a.row[0], b.row[0]) && same(a.row[1], b.row[1]) && same(a.row[2], b.row[2]);
}

// Rounded once. Vertices that triangles share stay the same.
Vec3 to_world(const Mat34& m, Vec3 p) {
    const auto along = [p](const Vec4& row) {
        return float(double(row.x) * p.x + double(row.y) * p.y + double(row.z) * p.z + row.w);
    };
    return {along(m.row[0]), along(m.row[1]), along(m.row[2])};
}

// Whether an object's world coordinates are precise for its size.
bool is_near(const Bounds& box, const Mat34& object_to_world) {
    const Vec3 centre = transform_point(object_to_world, (box.low + box.high) * 0.5f);
    const Vec3 diagonal = transform_vector(object_to_world, box.high - box.low);
    return is_finite(centre) && is_finite(diagonal) &&
           max_component(abs(centre)) <= farthest * max_component(abs(diagonal));
}

}  // namespace

void MergedObjects::update(Device& device, std::span<const std::shared_ptr<Mesh>> meshes,
                           std::span<const Instance> instances, std::span<const Placement> placements,
                           std::span<const std::uint8_t> is_opaque) {
    std::vector<int> users(meshes.size());
    for (const Instance& instance : instances) ++users[std::size_t(instance.mesh)];
    Objects objects;
    for (std::size_t i = 0; i < instances.size(); ++i) {
        const std::shared_ptr<Mesh>& mesh = meshes[std::size_t(instances[i].mesh)];
        const Mat34& object_to_world = placements[i].object_to_world;
        if (users[std::size_t(instances[i].mesh)] == 1 && instances[i].visibility == ray_kind::all &&
            mesh->triangle_count() > 0 && !mesh->view().previous_positions &&
            is_same(object_to_world, placements[i].previous_object_to_world) &&
            is_near(mesh->bounds(), object_to_world))
            objects[mesh.get()] = {mesh, object_to_world, std::int32_t(i), is_opaque[i] != 0};
    }

    const auto find_still = [](const Objects& among, const Object& object) -> const Object* {
        const auto found = among.find(object.mesh.get());
        const bool is_still = found != among.end() && found->second.is_opaque == object.is_opaque &&
                              is_same(found->second.object_to_world, object.object_to_world);
        return is_still ? &found->second : nullptr;
    };
    std::vector<std::int32_t> instance_of_member(members_.size(), -1);
    std::size_t held = 0, waiting = 0;
    for (std::size_t i = 0; i < members_.size(); ++i)
        if (const Object* object = find_still(objects, members_[i])) {
            instance_of_member[i] = object->instance;
            held += object->mesh->triangle_count();
        }
    // What changes every time never counts.
    for (const auto& [mesh, object] : objects)
        if (!mesh_ || find_still(last_, object)) waiting += mesh->triangle_count();
    if (waiting > 2 * held) {
        build(device, objects);
    } else if (instance_of_member != instance_of_member_) {
        instance_of_member_ = std::move(instance_of_member);
        device_members_ = Buffer<std::int32_t>(device, std::span<const std::int32_t>(instance_of_member_), "instances");
    }
    has_members_ = std::any_of(instance_of_member_.begin(), instance_of_member_.end(), [](int i) { return i >= 0; });
    last_ = std::move(objects);
}

void MergedObjects::build(Device& device, const Objects& objects) {
    members_.clear();
    mesh_.reset();
    for (const auto& [mesh, object] : objects) members_.push_back(object);
    std::sort(members_.begin(), members_.end(),
              [](const Object& a, const Object& b) { return a.instance < b.instance; });
    std::vector<std::size_t> start{0};
    for (std::size_t i = 0; i < members_.size();) {
        const std::size_t end = start.back() + members_[i].mesh->triangle_count();
        if (end > most_triangles) {
            members_.erase(members_.begin() + std::ptrdiff_t(i));
        } else {
            start.push_back(end);
            ++i;
        }
    }
    if (members_.size() < 2) members_.clear();
    instance_of_member_.clear();
    for (const Object& member : members_) instance_of_member_.push_back(member.instance);
    device_members_ = Buffer<std::int32_t>(device, std::span<const std::int32_t>(instance_of_member_), "instances");
    if (members_.empty()) return;

    std::vector<LeafTriangle> triangles(start.back());
    std::vector<std::uint8_t> may_be_cut(start.back());
    for (std::size_t i = 0; i < members_.size(); ++i)
        device.download(triangles.data() + start[i], members_[i].mesh->view().triangles,
                        (start[i + 1] - start[i]) * sizeof(LeafTriangle));
    parallel_for(members_.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            for (std::size_t t = start[i]; t < start[i + 1]; ++t) {
                LeafTriangle& triangle = triangles[t];
                for (Vec3* vertex : {&triangle.vertex0, &triangle.vertex1, &triangle.vertex2})
                    *vertex = to_world(members_[i].object_to_world, *vertex);
                triangle.member = std::int32_t(i);
                triangle.leaf_triangle = std::int32_t(t - start[i]);
                may_be_cut[t] = members_[i].is_opaque;
            }
    });
    mesh_ = std::make_shared<Mesh>(device, triangles, may_be_cut);
}

}  // namespace svgf
