// SPDX-License-Identifier: Apache-2.0
// slam-gateway-web: parses arguments, loads the configuration and runs the loop; turns failures
// into exit codes.
#include <systemd/sd-daemon.h>

#include <CLI/CLI.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/signal_set.hpp>
#include <boost/system/system_error.hpp>
#include <exception>
#include <iostream>

#include "daemon/observability/log.hpp"
#include "daemon/observability/standard_output.hpp"
#include "web/server/io/page_hub.hpp"
#include "web/server/io/startup.hpp"
#include "web/server/io/web_server.hpp"

namespace {

constexpr int exit_failed = 1;
constexpr int exit_arguments = 2;
constexpr int exit_configuration = 78;  // EX_CONFIG

/// Operations own the connections. They must end before the hub and the server are destroyed.
class Loop : public boost::asio::io_context {
 public:
  Loop() : io_context(1) {}
  void end_operations() { shutdown(); }
};

void serve(const slamgw::web::Startup& startup) {
  const slamgw::Config& config = startup.parsed.config;
  Loop io;
  const slamgw::LogRetry log_retry(io);
  boost::asio::signal_set signals(io, SIGTERM, SIGINT);
  signals.async_wait([&io](boost::system::error_code, int) { io.stop(); });
  slamgw::web::PageHub hub(io, config, startup.tokens, SLAMGW_VERSION);
  slamgw::web::WebServer server(io, config.web, hub);
  slamgw::log_event(slamgw::Severity::notice,
                    "the page is at http://" + server.address() +
                        (startup.tokens.empty() ? "/ and only watches" : "/"));
  sd_notify(0, "READY=1");
  io.run();
  sd_notify(0, "STOPPING=1");
  hub.end();
  io.end_operations();
}

int run(const slamgw::web::Startup& startup) {
  slamgw::configure_log(startup.parsed.config.log.level);
  for (const slamgw::Problem& warning : startup.parsed.warnings)
    log_event(slamgw::Severity::warning, to_string(warning));
  try {
    serve(startup);
    return 0;
  } catch (const boost::system::system_error& error) {  // what() names a line of Boost's source
    log_event(slamgw::Severity::error, "web.listen: can't use " + startup.parsed.config.web.listen +
                                           ": " + error.code().message());
    return exit_failed;
  } catch (const std::exception& error) {
    log_event(slamgw::Severity::error,
              "web.listen " + startup.parsed.config.web.listen + ": " + error.what());
    return exit_failed;
  }
}

int start(const std::string& config_file, bool only_checks) {
  const slamgw::web::Startup startup = slamgw::web::load_startup(config_file);
  const bool is_good = startup.parsed.problems.empty();
  // The journal treats a line without a priority as information (sd-daemon(3)).
  const char* level = !only_checks && slamgw::stderr_is_journal() ? SD_ERR : "";
  for (const slamgw::Problem& problem : startup.parsed.problems)
    (only_checks ? std::cout : std::cerr) << level << to_string(problem) << '\n';
  if (only_checks)
    for (const slamgw::Problem& warning : startup.parsed.warnings)
      std::cerr << "warning: " << to_string(warning) << '\n';
  if (only_checks && is_good) std::cout << "OK\n";
  if (!is_good) return exit_configuration;
  return only_checks ? 0 : run(startup);
}

}  // namespace

int main(int argc, char** argv) {
  slamgw::open_standard_descriptors();
  CLI::App cli("Live page and metrics of slam-gateway", "slam-gateway-web");
  std::string config_file = "/etc/slam-gateway/gateway.json";
  bool only_checks = false;
  cli.add_option("--config", config_file, "Configuration file")->capture_default_str();
  cli.add_flag("--check-config", only_checks, "Check the configuration and exit");
  cli.set_version_flag("--version", "slam-gateway-web " SLAMGW_VERSION);
  try {
    cli.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return slamgw::end_output("slam-gateway-web", cli.exit(error) == 0 ? 0 : exit_arguments);
  }
  return slamgw::end_output("slam-gateway-web", start(config_file, only_checks));
}
