// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/installation.hpp"

#include <optional>
#include <utility>

#include "ctl/host/program.hpp"
#include "daemon/config/io/load.hpp"

namespace slamgw::ctl {

namespace fs = std::filesystem;

Installation::Installation(std::string configuration)
    : configuration_(fs::absolute(std::move(configuration)).lexically_normal().string()),
      parsed_(load_config(configuration_)) {}

std::vector<fs::path> Installation::files_elsewhere() const {
  const BrokerSettings& broker = parsed_.config.broker;
  std::vector<fs::path> files;
  for (const std::optional<std::string>* const file :
       {&broker.credentials_file, &broker.ca_file, &broker.certificate_file, &broker.key_file}) {
    std::error_code error;
    if (!*file || !fs::is_regular_file(**file, error)) continue;
    const fs::path path = fs::absolute(**file).lexically_normal();
    if (*path.lexically_relative(etc()).begin() == "..") files.push_back(path);
  }
  return files;
}

ServicePause::ServicePause(const Installation& installation) {
  if (!installation.is_service()) return;
  was_active_ = run_program({"systemctl", "is-active", "--quiet", service_unit}).status == 0;
  if (was_active_) run_or_fail({"systemctl", "stop", service_unit});
}

ServicePause::~ServicePause() {
  if (was_active_) run_program({"systemctl", "start", "--no-block", service_unit});
}

}  // namespace slamgw::ctl
