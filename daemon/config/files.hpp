// SPDX-License-Identifier: Apache-2.0
// The interface through which the parser reads files and checks certificates. Implemented by
// system_files.hpp and by the fake in tests/config.
#pragma once

#include <string>

#include "daemon/core/result.hpp"

namespace slamgw {

struct FileText {
  std::string text;
  unsigned mode = 0;            ///< permission bits, 0777
  std::string strange_owner{};  ///< neither root, nor the service's user, nor this process's
};

struct FileError {
  bool is_missing = false;
  bool is_denied = false;  ///< this user may not read it
  std::string text;        ///< "No such file or directory"
};

class Files {
 public:
  virtual ~Files() = default;
  /// Returns the whole text of a regular file of at most 1 MiB.
  virtual Result<FileText, FileError> read(const std::string& path) const = 0;
  /// Says why this PEM text is not a usable certificate (chain) or private key; empty when it is.
  virtual std::string certificate_fault(const std::string& pem) const = 0;
  virtual std::string key_fault(const std::string& pem) const = 0;
  /// Returns whether the key belongs to the first certificate. Call when both texts are good.
  virtual bool key_matches(const std::string& certificate_pem,
                           const std::string& key_pem) const = 0;
};

}  // namespace slamgw
