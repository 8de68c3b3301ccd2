// Keys and certificates for a test, made by the openssl program.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace tessera {

// A folder of its own, removed at the end.
class TemporaryCertificates {
 public:
  TemporaryCertificates() {
    std::string name = (std::filesystem::temp_directory_path() / "tessera-tls-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) std::abort();
    folder_ = name;
    Authority("ca");
    Certificate("server", "ca", 1, "subjectAltName=IP:127.0.0.1,DNS:localhost");
    Certificate("worker", "ca", 1, "subjectAltName=DNS:worker");
  }
  ~TemporaryCertificates() { std::filesystem::remove_all(folder_); }
  TemporaryCertificates(const TemporaryCertificates&) = delete;
  TemporaryCertificates& operator=(const TemporaryCertificates&) = delete;

  std::string Path(const std::string& name) const { return (folder_ / name).string(); }
  std::string Read(const std::string& name) const {
    std::ifstream file(Path(name));
    return {std::istreambuf_iterator<char>(file), {}};
  }
  // A file that only its owner may read. Its path.
  std::string Write(const std::string& name, const std::string& text) const {
    std::ofstream(Path(name)) << text;
    std::filesystem::permissions(Path(name), std::filesystem::perms::owner_read |
                                                 std::filesystem::perms::owner_write);
    return Path(name);
  }

  // NAME.pem and NAME.key.
  void Authority(const std::string& name) const {
    Run("req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1 -subj /CN=" + name +
        " -keyout " + Path(name + ".key") + " -out " + Path(name + ".pem"));
  }
  void Certificate(const std::string& name, const std::string& authority, int days,
                   const std::string& extension) const {
    Run("req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=" + name + " -keyout " +
        Path(name + ".key") + " -out " + Path(name + ".csr"));
    Write(name + ".ext", extension + "\n");
    Run("x509 -req -in " + Path(name + ".csr") + " -CA " + Path(authority + ".pem") + " -CAkey " +
        Path(authority + ".key") + " -CAcreateserial -days " + std::to_string(days) +
        " -extfile " + Path(name + ".ext") + " -out " + Path(name + ".pem"));
  }

 private:
  static void Run(const std::string& arguments) {
    ASSERT_EQ(std::system(("openssl " + arguments + " 2>/dev/null").c_str()), 0) << arguments;
  }

  std::filesystem::path folder_;
};

}  // namespace tessera
