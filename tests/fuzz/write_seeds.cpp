// Writes a target's seeds into a folder: where a fuzzer starts. Usage: NAME_seeds FOLDER
#include <filesystem>
#include <fstream>
#include <iostream>

#include "tests/fuzz/fuzz_target.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: " << argv[0] << " FOLDER\n";
    return 2;
  }
  std::filesystem::create_directories(argv[1]);
  int index = 0;
  for (const std::string& seed : tessera::FuzzSeeds()) {
    std::ofstream file(std::filesystem::path(argv[1]) / ("seed" + std::to_string(index++)),
                       std::ios::binary);
    if (!(file << seed).flush()) {
      std::cerr << "cannot write into " << argv[1] << "\n";
      return 1;
    }
  }
}
