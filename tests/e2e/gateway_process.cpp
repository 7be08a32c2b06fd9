// SPDX-License-Identifier: Apache-2.0
#include "tests/e2e/gateway_process.hpp"

#include <fmt/format.h>
#include <signal.h>

#include "tests/support/free_port.hpp"

namespace slamgw::test {
namespace {

std::string last_line(const std::string& text) {
  const std::size_t end = text.find_last_not_of('\n');
  if (end == std::string::npos) return {};
  const std::size_t before = text.find_last_of('\n', end);
  return text.substr(before == std::string::npos ? 0 : before + 1, end + 1);
}

}  // namespace

GatewayProcess::GatewayProcess(nlohmann::json configuration) : mqttsn_port_(free_udp_port()) {
  if (!configuration.contains("gateway")) configuration["gateway"]["id"] = "test";
  configuration["control"]["socket"] = directory_ / "control.sock";
  configuration["store"]["directory"] = directory_ / "store";
  configuration["mqttsn"]["listen"] = {fmt::format("[::]:{}", mqttsn_port_)};
  configuration["mqttsn"]["multicast_group"] = nullptr;
  if (configuration.contains("ble_mesh")) configuration["ble_mesh"]["device"] = tty();
  write_file(directory_ / "gateway.json", configuration.dump(2));
  start();
}

void GatewayProcess::start(const std::vector<std::string>& launcher) {
  process_.reset();
  std::vector<std::string> arguments = launcher;
  arguments.insert(arguments.end(), {SLAMGW_DAEMON, "--config", directory_ / "gateway.json"});
  process_ =
      std::make_unique<ChildProcess>(arguments, directory_ / "out", directory_ / "log", true);
}

void GatewayProcess::configure(const std::function<void(nlohmann::json&)>& change) {
  auto configuration = nlohmann::json::parse(read_file(directory_ / "gateway.json"));
  change(configuration);
  write_file(directory_ / "gateway.json", configuration.dump(2));
}

void GatewayProcess::reload(const std::function<void(nlohmann::json&)>& change) {
  configure(change);
  process_->send_signal(SIGHUP);
}

std::string GatewayProcess::log() const { return read_file(directory_ / "log"); }

nlohmann::json GatewayProcess::ctl(const std::vector<std::string>& command) const {
  std::vector<std::string> arguments{SLAMGW_CTL, "--socket", directory_ / "control.sock", "--json"};
  arguments.insert(arguments.end(), command.begin(), command.end());
  const Finished finished = run_program(arguments);
  if (finished.status != 0) return nullptr;
  return nlohmann::json::parse(finished.out, nullptr, false);
}

std::string GatewayProcess::place_in_fleet(const std::string& robot) const {
  const nlohmann::json fleet = ctl({"fleet"});
  if (!fleet.is_object()) return "";
  for (const nlohmann::json& row : fleet["robots"])
    if (row["robot"] == robot) return row["gateway"];
  return "";
}

std::string GatewayProcess::mqttsn_address() const {
  return fmt::format("127.0.0.1:{}", mqttsn_port_);
}

Finished run_program(const std::vector<std::string>& arguments, std::chrono::milliseconds limit) {
  const TempDir directory;
  ChildProcess process(arguments, directory / "out", directory / "err");
  const auto status = process.wait(limit);
  return {status, read_file(directory / "out"), read_file(directory / "err")};
}

SimulatorProcess::SimulatorProcess(const std::vector<std::string>& arguments) {
  std::vector<std::string> command{SLAMGW_SIM};
  command.insert(command.end(), arguments.begin(), arguments.end());
  process_ = std::make_unique<ChildProcess>(command, directory_ / "out", directory_ / "err");
}

nlohmann::json SimulatorProcess::report() {
  process_->wait();
  return nlohmann::json::parse(last_line(read_file(directory_ / "out")), nullptr, false);
}

std::string SimulatorProcess::errors() const { return read_file(directory_ / "err"); }

}  // namespace slamgw::test
