// SPDX-License-Identifier: Apache-2.0
// Files on this host's disk, PEM read by OpenSSL.
#pragma once

#include "daemon/config/files.hpp"

namespace slamgw {

class SystemFiles : public Files {
 public:
  /// `owner`: the user who may own a secret, besides root and this process's user.
  explicit SystemFiles(const char* owner) : service_user_(owner) {}
  Result<FileText, FileError> read(const std::string& path) const override;
  std::string certificate_fault(const std::string& pem) const override;
  std::string key_fault(const std::string& pem) const override;
  bool key_matches(const std::string& certificate_pem, const std::string& key_pem) const override;
  /// Returns the name of this user if it may not own a secret; else nothing.
  std::string strange_owner(unsigned user) const;

 private:
  const char* service_user_;
};

}  // namespace slamgw
