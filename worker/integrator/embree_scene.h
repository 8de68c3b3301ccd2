// The scene's geometry in Embree: nearest hits and shadow rays. Alpha is decided inside traversal:
// a nearest-hit query meets a blended point with probability alpha, by a hash of (ray key,
// instance, triangle), whatever the order of traversal; a shadow ray multiplies transmittances.
// Knows no material but its alpha. The only file that includes Embree besides its source.
#pragma once

#include <Imath/ImathBox.h>
#include <embree3/rtcore.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "worker/integrator/surface_reader.h"
#include "worker/scene/scene.h"

namespace tessera {

struct Ray {
  V3f origin;
  V3f direction;  // any length
  float t_max;    // in units of the direction
};

class EmbreeScene {
 public:
  // Builds the hierarchies with the threads that TBB is given; they do not change its bits.
  // Adds room behind each mesh's positions, as Embree reads 16 bytes at a time. Borrows both.
  // Errors: RESOURCE_EXHAUSTED  Embree is out of memory
  //         INVALID_ARGUMENT    unknown ISA class
  static absl::StatusOr<std::unique_ptr<EmbreeScene>> Create(Scene* scene,
                                                             const SurfaceReader& surfaces,
                                                             const std::string& isa);
  ~EmbreeScene();
  EmbreeScene(const EmbreeScene&) = delete;
  EmbreeScene& operator=(const EmbreeScene&) = delete;

  // The nearest hit, if any. `key` decides blended alpha. Threads: const, any number at once.
  bool Intersect(const Ray& ray, uint64_t key, RayHit* hit) const;
  // The share of light that passes along the ray, [0, 1].
  float Transmittance(const Ray& ray) const;

  Imath::Box3f bounds() const;
  int64_t memory_bytes() const { return memory_bytes_.load(std::memory_order_relaxed); }

 private:
  struct DeviceRelease {
    void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
  };
  struct SceneRelease {
    void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
  };
  using DeviceHandle = std::unique_ptr<RTCDeviceTy, DeviceRelease>;
  using SceneHandle = std::unique_ptr<RTCSceneTy, SceneRelease>;

  EmbreeScene() = default;
  absl::Status Build(Scene* scene, const SurfaceReader& surfaces);
  SceneHandle NewScene();
  RTCGeometry NewTriangles(Mesh* mesh, const SurfaceReader& surfaces);
  absl::Status DeviceStatus() const;

  std::atomic<int64_t> memory_bytes_ = 0;  // outlives the device, which reports its frees to it
  DeviceHandle device_;
  std::vector<SceneHandle> meshes_;  // of meshes used more than once
  SceneHandle world_;
};

}  // namespace tessera
