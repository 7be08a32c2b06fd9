// SPDX-License-Identifier: Apache-2.0
// slam-gatewayd: reads arguments and configuration, runs the gateway, and returns failures as exit
// codes.
#include <sys/resource.h>
#include <systemd/sd-daemon.h>

#include <CLI/CLI.hpp>
#include <exception>
#include <iostream>
#include <string_view>

#include "daemon/app/app.hpp"
#include "daemon/config/default_config.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/standard_output.hpp"

namespace {

constexpr int exit_failed = 1;
constexpr int exit_arguments = 2;
constexpr int exit_configuration = 78;  // EX_CONFIG

struct Arguments {
  std::string config_file = "/etc/slam-gateway/gateway.json";
  bool check_config = false;
  bool print_config = false;
};

/// `before`: written in front of each line.
void print(const slamgw::Problems& problems, std::ostream& out, std::string_view before = {}) {
  for (const slamgw::Problem& problem : problems) out << before << to_string(problem) << '\n';
}

int check_config(const slamgw::ParseResult& result) {
  print(result.notices, std::cerr, "notice: ");
  print(result.warnings, std::cerr, "warning: ");
  print(result.problems, std::cout);
  if (!result.problems.empty()) return exit_configuration;
  std::cout << "OK\n";
  return 0;
}

/// Raises the soft limit of open files to the hard one: each robot has its own connection to the
/// broker, and systemd starts services with a soft limit of 1024.
void allow_many_files() {
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

int run(const slamgw::ParseResult& result, const std::string& config_file) {
  allow_many_files();
  slamgw::configure_log(result.config.log.level);
  for (const slamgw::Problem& notice : result.notices)
    log_event(slamgw::Severity::notice, to_string(notice));
  for (const slamgw::Problem& warning : result.warnings)
    log_event(slamgw::Severity::warning, to_string(warning));
  try {
    slamgw::run_gateway(result.config, config_file);
    return 0;
  } catch (const std::exception& error) {
    log_event(slamgw::Severity::error, error.what());
    return exit_failed;
  }
}

int start(const Arguments& arguments) {
  if (arguments.print_config) {
    std::cout << slamgw::default_config_text;
    return 0;
  }
  const slamgw::ParseResult result = slamgw::load_config(arguments.config_file);
  if (arguments.check_config) return check_config(result);
  // The journal takes a line without a priority (sd-daemon(3)) for information.
  print(result.problems, std::cerr, slamgw::stderr_is_journal() ? SD_ERR : "");
  return result.problems.empty() ? run(result, arguments.config_file) : exit_configuration;
}

}  // namespace

int main(int argc, char** argv) {
  slamgw::open_standard_descriptors();
  CLI::App cli("Gateway between radio meshes of robots and MQTT", "slam-gatewayd");
  Arguments arguments;
  cli.add_option("--config", arguments.config_file, "Configuration file")->capture_default_str();
  cli.add_flag("--check-config", arguments.check_config, "Check the configuration and exit");
  cli.add_flag("--print-config", arguments.print_config, "Print the default configuration");
  cli.set_version_flag("--version", "slam-gatewayd " SLAMGW_VERSION);
  try {
    cli.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return slamgw::end_output("slam-gatewayd", cli.exit(error) == 0 ? 0 : exit_arguments);
  }
  return slamgw::end_output("slam-gatewayd", start(arguments));
}
