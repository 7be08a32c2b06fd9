// SPDX-License-Identifier: Apache-2.0
#include "tests/support/temp_dir.hpp"

#include <sys/stat.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace slamgw::test {

TempDir::TempDir() {
  std::string pattern = (std::filesystem::temp_directory_path() / "slam-gateway-XXXXXX").string();
  if (!mkdtemp(pattern.data())) throw std::runtime_error("mkdtemp failed");
  path_ = pattern;
}

TempDir::~TempDir() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

void write_file(const std::string& path, std::string_view text, unsigned mode) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << text;
  chmod(path.c_str(), mode);
}

std::string read_file(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

std::string read_files(const std::string& directory) {
  std::string all;
  std::error_code none;
  for (const auto& file : std::filesystem::directory_iterator(directory, none))
    all += read_file(file.path());
  return all;
}

}  // namespace slamgw::test
