// SPDX-License-Identifier: Apache-2.0
// Where this host keeps what the gateway needs, read from its configuration, and its service.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "daemon/config/parse.hpp"

namespace slamgw::ctl {

inline constexpr const char* service_unit = "slam-gateway.service";
inline constexpr const char* service_configuration = "/etc/slam-gateway/gateway.json";

class Installation {
 public:
  /// Reads the configuration; it need not be without problems.
  explicit Installation(std::string configuration);

  const std::string& configuration() const { return configuration_; }
  const ParseResult& parsed() const { return parsed_; }
  /// The configuration's directory: everything in it belongs to the site.
  std::filesystem::path etc() const { return std::filesystem::path(configuration_).parent_path(); }
  std::filesystem::path state() const { return parsed_.config.store.directory; }
  /// Files outside of `etc()` that the configuration names and that exist (keys, certificates).
  std::vector<std::filesystem::path> files_elsewhere() const;
  /// The configuration is the one that the packaged service reads.
  bool is_service() const { return configuration_ == service_configuration; }

 private:
  std::string configuration_;
  ParseResult parsed_;
};

/// Stops the service while it lives, and starts it again if it ran. Does nothing for a
/// configuration that is not the service's.
class ServicePause {
 public:
  explicit ServicePause(const Installation& installation);
  ~ServicePause();
  ServicePause(const ServicePause&) = delete;
  ServicePause& operator=(const ServicePause&) = delete;

 private:
  bool was_active_ = false;
};

}  // namespace slamgw::ctl
