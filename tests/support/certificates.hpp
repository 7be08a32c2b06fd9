// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "tests/support/temp_dir.hpp"

namespace slamgw::test {

/// A certificate authority and a server certificate for one host name, made with the openssl
/// program.
class Certificates {
 public:
  explicit Certificates(const std::string& host_name);

  std::string ca() const { return directory_ / "ca.pem"; }
  std::string certificate() const { return directory_ / "server.pem"; }
  std::string key() const { return directory_ / "server.key"; }

 private:
  TempDir directory_;
};

}  // namespace slamgw::test
