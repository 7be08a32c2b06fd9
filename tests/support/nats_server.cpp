// SPDX-License-Identifier: Apache-2.0
#include "tests/support/nats_server.hpp"

#include <fmt/format.h>

#include <stdexcept>

#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"

namespace slamgw::test {

bool NatsServer::is_installed() {
  return ChildProcess({"sh", "-c", "command -v nats-server"}).wait() == 0;
}

NatsServer::NatsServer(const std::string& extra_configuration) : mqtt_port_(free_tcp_port()) {
  write_file(directory_ / "nats.conf", fmt::format("server_name: n1\nlisten: \"127.0.0.1:{}\"\n"
                                                   "jetstream {{ store_dir: \"{}\" }}\n"
                                                   "mqtt {{ host: \"127.0.0.1\", port: {} }}\n{}",
                                                   free_tcp_port(), directory_ / "jetstream",
                                                   mqtt_port_, extra_configuration));
  process_ = std::make_unique<ChildProcess>(
      std::vector<std::string>{"nats-server", "-c", directory_ / "nats.conf"}, std::string(),
      directory_ / "log");
  const auto is_ready = [this] { return log().find("Server is ready") != std::string::npos; };
  if (!eventually([&] { return is_ready() || !process_->is_running(); }) || !is_ready())
    throw std::runtime_error("nats-server does not start: " + log());
}

}  // namespace slamgw::test
