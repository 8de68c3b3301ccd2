#include "worker/integrator/embree_scene.h"

#include <limits>

#include "absl/strings/str_cat.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/isa_class.h"
#include "worker/integrator/portable_math.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {
namespace {

// What the filters know of the ray at hand. Embree hands back its first member.
struct QueryContext {
  RTCIntersectContext embree;
  uint64_t key;
  // -ln of what passes, in 2^-24: whole numbers, as their sum does not depend on the order in which
  // traversal meets surfaces.
  int64_t depth;
};

constexpr float kDepthUnit = 1 << 24;

QueryContext NewContext(uint64_t key) {
  QueryContext context;
  rtcInitIntersectContext(&context.embree);
  context.key = key;
  context.depth = 0;
  return context;
}

RTCRay ToEmbree(const Ray& ray) {
  return {ray.origin.x,    ray.origin.y,    ray.origin.z,    0,
          ray.direction.x, ray.direction.y, ray.direction.z, 0,
          ray.t_max,       0xffffffffu,     0,               0};
}

struct FilteredHit {
  uint32_t instance;
  uint32_t triangle;
  float alpha;
};

FilteredHit ReadFilteredHit(const RTCFilterFunctionNArguments* args) {
  const auto& surfaces = *static_cast<const SurfaceReader*>(args->geometryUserPtr);
  RTCHitN* hit = args->hit;
  const uint32_t in = RTCHitN_instID(hit, 1, 0, 0);
  const uint32_t instance = in != RTC_INVALID_GEOMETRY_ID ? in : RTCHitN_geomID(hit, 1, 0);
  const uint32_t triangle = RTCHitN_primID(hit, 1, 0);
  return {instance, triangle,
          surfaces.Alpha(instance, triangle, RTCHitN_u(hit, 1, 0), RTCHitN_v(hit, 1, 0))};
}

void FilterNearest(const RTCFilterFunctionNArguments* args) {
  const FilteredHit hit = ReadFilteredHit(args);
  const auto* context = reinterpret_cast<const QueryContext*>(args->context);
  const uint64_t place = uint64_t{hit.instance} << 32 | hit.triangle;
  const uint64_t hash = MixBits(context->key ^ MixBits(place + 0x9e3779b97f4a7c15ull));
  if (!(UnitFloat(static_cast<uint32_t>(hash >> 32)) < hit.alpha)) args->valid[0] = 0;
}

void FilterShadow(const RTCFilterFunctionNArguments* args) {
  auto* context = reinterpret_cast<QueryContext*>(args->context);
  const float passes = 1 - ReadFilteredHit(args).alpha;
  if (!(passes >= 0x1p-126f)) return;
  context->depth += static_cast<int64_t>(-Ln(passes) * kDepthUnit);
  args->valid[0] = 0;
}

bool CountMemory(void* counter, ssize_t bytes, bool /*post*/) {
  static_cast<std::atomic<int64_t>*>(counter)->fetch_add(bytes, std::memory_order_relaxed);
  return true;
}

}  // namespace

absl::StatusOr<std::unique_ptr<EmbreeScene>> EmbreeScene::Create(Scene* scene,
                                                                 const SurfaceReader& surfaces,
                                                                 const std::string& isa) {
  absl::StatusOr<std::string> embree_isa = EmbreeIsaOf(isa);
  if (!embree_isa.ok()) return embree_isa.status();
  std::unique_ptr<EmbreeScene> result(new EmbreeScene());
  // Embree would take four-wide kernels, with other bits, on processors of some models (Skylake's
  // servers) that clock down for wider ones.
  result->device_.reset(
      rtcNewDevice(absl::StrCat("isa=", *embree_isa, ",frequency_level=simd256").c_str()));
  if (result->device_ == nullptr) {
    return absl::FailedPreconditionError(
        absl::StrCat("Embree makes no device of ISA class ", isa, " (error ",
                     static_cast<int>(rtcGetDeviceError(nullptr)), "); choose another --isa"));
  }
  rtcSetDeviceMemoryMonitorFunction(result->device_.get(), CountMemory, &result->memory_bytes_);
  if (absl::Status status = result->Build(scene, surfaces); !status.ok()) return status;
  return result;
}

EmbreeScene::~EmbreeScene() = default;

EmbreeScene::SceneHandle EmbreeScene::NewScene() {
  SceneHandle scene(rtcNewScene(device_.get()));
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(scene.get(), RTC_BUILD_QUALITY_MEDIUM);
  return scene;
}

RTCGeometry EmbreeScene::NewTriangles(Mesh* mesh, const SurfaceReader& surfaces) {
  mesh->positions.reserve(mesh->positions.size() + 2);
  RTCGeometry geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                             mesh->positions.data(), 0, sizeof(V3f), mesh->positions.size());
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                             mesh->triangles.data(), 0, sizeof(mesh->triangles[0]),
                             mesh->triangles.size());
  if (kMayHave.alpha && (surfaces.HasAlpha(*mesh) || !Steps().opaque_meshes)) {
    rtcSetGeometryUserData(geometry, const_cast<SurfaceReader*>(&surfaces));
    rtcSetGeometryIntersectFilterFunction(geometry, FilterNearest);
    rtcSetGeometryOccludedFilterFunction(geometry, FilterShadow);
  }
  rtcCommitGeometry(geometry);
  return geometry;
}

absl::Status EmbreeScene::Build(Scene* scene, const SurfaceReader& surfaces) {
  world_ = NewScene();
  meshes_.resize(scene->meshes.size());
  for (uint32_t i = 0; i < scene->instances.size(); ++i) {
    const Instance& instance = scene->instances[i];
    Mesh* mesh = &scene->meshes[instance.mesh];
    if (mesh->triangles.empty()) continue;
    RTCGeometry geometry;
    if (!surfaces.geometry(i).instanced) {
      geometry = NewTriangles(mesh, surfaces);
    } else {
      SceneHandle& own = meshes_[instance.mesh];
      if (own == nullptr) {
        own = NewScene();
        RTCGeometry triangles = NewTriangles(mesh, surfaces);
        rtcAttachGeometryByID(own.get(), triangles, 0);
        rtcReleaseGeometry(triangles);
        rtcCommitScene(own.get());
      }
      geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_INSTANCE);
      rtcSetGeometryInstancedScene(geometry, own.get());
      // Row vectors in row-major order are column vectors in column-major order.
      rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT4X4_COLUMN_MAJOR,
                              &instance.to_world[0][0]);
      rtcCommitGeometry(geometry);
    }
    rtcAttachGeometryByID(world_.get(), geometry, i);
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(world_.get());
  return DeviceStatus();
}

absl::Status EmbreeScene::DeviceStatus() const {
  switch (const RTCError error = rtcGetDeviceError(device_.get())) {
    case RTC_ERROR_NONE:
      return absl::OkStatus();
    case RTC_ERROR_OUT_OF_MEMORY:
      return absl::ResourceExhaustedError(
          "no memory for the scene's acceleration structures; use a machine with more");
    default:
      return absl::InternalError(absl::StrCat("Embree error ", static_cast<int>(error)));
  }
}

bool EmbreeScene::Intersect(const Ray& ray, uint64_t key, RayHit* hit) const {
  QueryContext context = NewContext(key);
  RTCRayHit query;
  query.ray = ToEmbree(ray);
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(world_.get(), &context.embree, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;
  const uint32_t in = kMayHave.instances ? query.hit.instID[0] : RTC_INVALID_GEOMETRY_ID;
  *hit = {in != RTC_INVALID_GEOMETRY_ID ? in : query.hit.geomID, query.hit.primID, query.hit.u,
          query.hit.v, query.ray.tfar};
  return true;
}

float EmbreeScene::Transmittance(const Ray& ray) const {
  QueryContext context = NewContext(0);
  RTCRay query = ToEmbree(ray);
  rtcOccluded1(world_.get(), &context.embree, &query);
  if (query.tfar < 0) return 0;
  if (!kMayHave.alpha || context.depth == 0) return 1;
  return ExpNegative(-static_cast<float>(context.depth) / kDepthUnit);
}

Imath::Box3f EmbreeScene::bounds() const {
  RTCBounds b;
  rtcGetSceneBounds(world_.get(), &b);
  if (!(b.lower_x <= b.upper_x)) return {};
  return {{b.lower_x, b.lower_y, b.lower_z}, {b.upper_x, b.upper_y, b.upper_z}};
}

}  // namespace tessera
