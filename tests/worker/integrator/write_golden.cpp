// Writes the references of path_tracer_golden_test: write_golden FOLDER (tests/worker/golden).
// Run it only after a change that is meant to move the mean, and say in the commit why it may.
// Takes a minute.
#include <cstdio>
#include <fstream>
#include <iomanip>
#include <string>

#include "tests/worker/integrator/golden_scenes.h"

int main(int argc, char** argv) {
  using namespace tessera::testing;
  if (argc != 2) {
    std::fprintf(stderr, "usage: write_golden FOLDER\n");
    return 2;
  }
  for (const GoldenScene& scene : GoldenScenes()) {
    const GoldenMoments moments = MeasureGolden(scene, 1000000, kGoldenSeeds, kGoldenSpp);
    std::ofstream file(std::string(argv[1]) + "/" + scene.name + ".txt");
    file << "# mean radiance and the variance of that mean, R G B of each pixel, rows of "
         << kGoldenWidth << "; " << kGoldenSeeds << " seeds x " << kGoldenSpp << " samples\n"
         << std::setprecision(7);
    for (size_t v = 0; v < moments.mean.size(); ++v) {
      file << moments.mean[v] << ' ' << moments.variance_of_mean[v] << '\n';
    }
    if (!file.flush()) {
      std::fprintf(stderr, "cannot write into %s\n", argv[1]);
      return 2;
    }
  }
  return 0;
}
