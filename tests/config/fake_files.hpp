// SPDX-License-Identifier: Apache-2.0
// Files in a map. A PEM text is valid when it starts with "certificate" or "key".
#pragma once

#include <map>
#include <string>

#include "daemon/config/files.hpp"

namespace slamgw::test {

class FakeFiles : public Files {
 public:
  std::map<std::string, FileText> files;
  std::map<std::string, FileError> errors;

  Result<FileText, FileError> read(const std::string& path) const override {
    if (const auto error = errors.find(path); error != errors.end()) return error->second;
    const auto file = files.find(path);
    if (file == files.end()) return FileError{true, false, "No such file or directory"};
    return file->second;
  }
  std::string certificate_fault(const std::string& pem) const override {
    return pem.starts_with("certificate") ? "" : "holds no certificate";
  }
  std::string key_fault(const std::string& pem) const override {
    return pem.starts_with("key") ? "" : "holds no private key";
  }
  bool key_matches(const std::string& certificate_pem, const std::string& key_pem) const override {
    return certificate_pem.substr(certificate_pem.find(' ')) == key_pem.substr(key_pem.find(' '));
  }
};

}  // namespace slamgw::test
