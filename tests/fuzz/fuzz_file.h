// A file of this process, for parsers that read files: it ends with the process.
#pragma once

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>

namespace tessera {

class FuzzFile {
 public:
  explicit FuzzFile(const std::string& extension)
      : path_((std::filesystem::temp_directory_path() / "tessera-fuzz-").string() +
              std::to_string(getpid()) + extension) {}
  ~FuzzFile() { std::filesystem::remove(path_); }
  const std::string& path() const { return path_; }
  void Write(std::string_view bytes) const {
    std::ofstream(path_, std::ios::binary) << bytes;
    chmod(path_.c_str(), S_IRUSR | S_IWUSR);
  }
  std::string Read() const {
    std::ifstream file(path_, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

 private:
  const std::string path_;
};

}  // namespace tessera
