// SPDX-License-Identifier: Apache-2.0
// Files on this host's disk, PEM read by OpenSSL.
#pragma once

#include "daemon/config/files.hpp"

namespace slamgw {

class SystemFiles : public Files {
 public:
  Result<FileText, FileError> read(const std::string& path) const override;
  std::string certificate_fault(const std::string& pem) const override;
  std::string key_fault(const std::string& pem) const override;
  bool key_matches(const std::string& certificate_pem, const std::string& key_pem) const override;
};

}  // namespace slamgw
