// SPDX-License-Identifier: Apache-2.0
// The tasks that slam-gatewayctl performs by itself, on the gateway's host.
#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <utility>

#include "ctl/command_line.hpp"
#include "ctl/host/archives.hpp"
#include "ctl/host/audit.hpp"
#include "ctl/host/doctor.hpp"
#include "ctl/host/recording.hpp"
#include "ctl/host/robot_check.hpp"
#include "ctl/host/robot_keys.hpp"
#include "ctl/terminal.hpp"
#include "daemon/config/rules.hpp"
#include "daemon/control/wire.hpp"
#include "daemon/core/bans.hpp"

namespace slamgw::ctl {
namespace {

/// Writes the result of a task on this host in words.
int print_words(const Order& order, const std::string& words) {
  if (!order.json) {
    std::cout << words;
    return 0;
  }
  nlohmann::ordered_json answer{{"text", words}};
  if (!order.file.empty()) answer["file"] = order.file;
  std::cout << control::to_line(answer);
  return 0;
}

int print_findings(const Order& order, const std::vector<Finding>& findings) {
  std::cout << (order.json ? control::to_line(to_json(findings))
                           : fit_to_terminal(to_text(findings), STDOUT_FILENO));
  return has_problem(findings) ? exit_failed : 0;
}

/// Returns the gateway on this host. With --socket alone, asks the daemon that listens there for
/// its configuration.
Installation installation_of(const Order& order) {
  if (!order.is_by_socket) return Installation(order.configuration);
  try {
    const auto status = Connection(order.socket).ask({{"command", "status"}});
    if (const std::string named = string_at(status, "configuration"); !named.empty())
      return Installation(named);
  } catch (const NotRunning&) {
  }
  throw Failure("no daemon at " + order.socket +
                " says which configuration it reads: name it with --config");
}

/// Makes a running daemon read the changed file; a daemon that starts later reads it then. Returns
/// the result in words.
std::string reload(const Order& order) {
  try {
    const auto answer = Connection(order.socket).ask({{"command", "reload"}});
    const std::string left = text_at(answer, "needs_restart");
    return left.empty() ? "" : "Only a restart changes: " + left + "\n";
  } catch (const NotRunning&) {
    return "The gateway is not running; the change takes effect when it starts.\n";
  } catch (const Failure& failure) {
    throw Failure(
        fmt::format("the change is written, but takes effect only after slam-gatewayctl "
                    "reload: {}",
                    failure.what()));
  }
}

/// Says so if no robot has this name: it may be mistyped. Asks nothing about an address.
std::string words_on_unknown(const Order& order, const Config& config) try {
  const auto is_named = [&](const RobotName& robot) {
    return robot.id == order.robot || robot.mqttsn_client_id == order.robot;
  };
  if (IpNetwork::parse(order.robot) || std::ranges::any_of(config.robots, is_named)) return "";
  Connection daemon(order.socket);
  const auto heard = daemon.ask({{"command", "robots"}, {"robot", order.robot}});
  const auto fleet = daemon.ask({{"command", "fleet"}});  // also robots that are elsewhere
  const auto is_shown = [&](const auto& row) { return text_at(row, "robot") == order.robot; };
  const bool is_known = !heard.empty() || std::ranges::any_of(list_at(fleet, "robots"), is_shown);
  return is_known ? "" : "No robot of this name is known; it is banned all the same.\n";
} catch (const Failure&) {
  return "";
}

int change_ban(const Order& order, const char* verb, bool is_banned) {
  const Installation installation = installation_of(order);
  return print_words(order, recorded({verb, order.robot}, [&] {
                       std::string done = change_bans(installation, order.robot, is_banned);
                       done += reload(order);
                       const Config& config = installation.parsed().config;
                       return is_banned ? done + words_on_unknown(order, config) : done;
                     }));
}

int print_keys(const Order& order, const nlohmann::ordered_json& answer) {
  std::cout << (order.json ? control::to_line(answer)
                           : text_of_keys(answer, isatty(STDOUT_FILENO) == 1));
  return 0;
}

/// Shows a new key even if the daemon then fails to reload.
int change_key(const Order& order, const char* verb, bool is_added) {
  const Installation installation = installation_of(order);
  recorded({verb, order.robot}, [&] {
    print_keys(order, change_keys(installation, order.robot, is_added));
    std::cerr << reload(order);
    return std::string();
  });
  return 0;
}

/// Returns the service's credentials. Reads their source file, because only the service's process
/// can read the copy that systemd makes.
std::optional<Credentials> service_credentials() {
  const auto credentials = load_service_credentials();
  if (credentials) return *credentials;
  throw Failure(to_string(credentials.error()) + " (type sudo, or name a user with --user)");
}

BrokerSettings broker_for(const Installation& installation, const Order& order) {
  const auto& [config, problems, warnings, notices, places, secrets, file] = installation.parsed();
  if (order.broker.empty()) {
    if (!problems.empty())
      throw Failure(to_string(problems.front()) + " (or name another broker with --broker)");
    BrokerSettings broker = config.broker;
    if (installation.is_service() && !broker.credentials_file && order.user.empty())
      broker.credentials = service_credentials();
    return broker;
  }
  const auto address = parse_broker_uri(order.broker).value();  // the command line has checked it
  BrokerSettings broker = problems.empty() ? config.broker : BrokerSettings{};
  broker.host = address.host;
  broker.port = address.port;
  broker.tls = address.tls;
  broker.others.clear();
  broker.credentials.reset();  // these are for the configuration's broker
  return broker;
}

/// Asks on standard error, because a program may read standard output.
bool may_replace(const std::string& files) {
  std::cerr << "restore replaces these files, and keeps them under another name:\n"
            << files << "Go on? [y/N] " << std::flush;
  std::string answer;
  std::getline(std::cin, answer);
  return answer == "y" || answer == "Y" || answer == "yes";
}

int doctor(const Order& order) {
  const Installation installation = installation_of(order);
  if (order.robot.empty())
    return print_findings(order, examine(gather_facts(installation, order.socket)));
  Connection daemon(order.socket);
  return print_findings(order, examine_robot(order.robot, gather_robot_facts(order.robot, daemon),
                                             installation.parsed()));
}

int check(const Order& order) {
  const std::chrono::minutes time(order.minutes);
  {
    Connection daemon(order.socket);
    warn_of_unheard(daemon, order.robot);
  }
  std::cerr << fmt::format("watching {} for {} min\n", order.robot, order.minutes);
  return print_findings(order, judge_robot(watch_robot(order.robot, time, order.socket)));
}

int restore(const Order& order) {
  const Installation installation = installation_of(order);
  return print_words(order, recorded({"restore", {}}, [&] {
                       return ctl::restore(installation, order.file, [&](const std::string& files) {
                         return order.is_confirmed || may_replace(files);
                       });
                     }));
}

int replay(const Order& order) {
  std::ifstream file = open_file(order.file);
  auto messages = read_recording(file, order.file);
  if (messages.empty()) throw Failure(order.file + " holds no message of a robot");
  BrokerSettings broker = broker_for(installation_of(order), order);
  const bool is_user_typed = !order.user.empty();
  if (is_user_typed) {
    broker.credentials = {order.user, read_password(order.user)};
    broker.credentials_file.reset();
  }
  const std::chrono::duration<double> length = messages.back().after;
  std::cerr << fmt::format("publishing {} over {:.1f} s to {}:{}\n",
                           counted(messages.size(), "message", "messages"),
                           length.count() / order.speed, broker.host, broker.port);
  const Replayed done =
      ctl::replay(std::move(messages), std::move(broker), order.speed, is_user_typed);
  if (order.json) {
    std::cout << control::to_line({{"published", done.published}, {"refused", done.refused}});
  } else {
    std::cout << counted(done.published, "message", "messages") << " published";
    if (done.refused > 0) std::cout << ", " << done.refused << " refused: " << done.why;
    std::cout << '\n';
  }
  return done.refused == 0 ? 0 : exit_failed;
}

std::string complaint_about_broker(const std::string& uri) {
  return parse_broker_uri(uri) ? "" : uri + " is not mqtt://host:port or mqtts://host:port";
}

/// Used in place of CLI::Range, which accepts "nan".
std::string complaint_about_speed(const std::string& factor) {
  const double number = std::strtod(factor.c_str(), nullptr);
  return number >= 0.001 && number <= 1000 ? "" : factor + " is not a factor from 0.001 to 1000";
}

}  // namespace

void add_host_commands(CLI::App& app, Order& order) {
  using Perform = decltype(Order::perform);
  const auto add_to = [&](CLI::App& group, const char* verb, const char* what, Perform perform) {
    CLI::App* task = group.add_subcommand(verb, what);
    CLI::Option* const configuration =
        task->add_option("--config", order.configuration, "The daemon's configuration")
            ->capture_default_str();
    task->callback([&order, &app, perform, configuration] {
      order.perform = perform;
      order.is_by_socket = app.count("--socket") > 0 && configuration->count() == 0;
    });
    return task;
  };
  const auto add = [&](const char* verb, const char* what, Perform perform) {
    return add_to(app, verb, what, perform);
  };
  add("doctor", "The way from radio to broker: what is well, what to do", doctor)
      ->add_option("ROBOT", order.robot, "What is known of this robot, and why it is silent");
  CLI::App* checking = add("check", "Watch a robot: what its firmware should do otherwise", check);
  checking->add_option("ROBOT", order.robot, "The robot's id")->required();
  checking->add_option("--minutes", order.minutes, "For how long")
      ->check(CLI::Range(1, 24 * 60))
      ->capture_default_str();
  const auto add_with_file = [&](const char* verb, const char* what, Perform perform) {
    CLI::App* task = add(verb, what, perform);
    task->add_option("FILE", order.file, "The archive")->required();
    return task;
  };
  add_with_file("backup", "Configuration, credentials, mesh keys and kept messages into one file",
                [](const Order& given) {
                  return print_words(given, backup(installation_of(given), given.file));
                });
  add_with_file("restore", "Restore a backup, on this host or a new one", restore)
      ->add_flag("--yes", order.is_confirmed, "Replace files without asking");
  CLI::App* replaying =
      add("replay", "Publish recorded messages of robots with the recorded timing", replay);
  replaying->add_option("FILE", order.file, "Made by record")->required();
  replaying->add_option("--broker", order.broker, "mqtt://host:port; else the configuration's")
      ->check(complaint_about_broker);
  replaying->add_option("--user", order.user, "At the broker; its password is asked for");
  replaying->add_option("--speed", order.speed, "2: twice as fast")->check(complaint_about_speed);
  add("ban", "Refuse a robot or an address, until unban",
      [](const Order& given) { return change_ban(given, "ban", true); })
      ->add_option("WHO", order.robot, "A robot's id, an address, or a network: fd00::/64")
      ->required()
      ->check([](const std::string& who) {
        return Bans::is_valid(who) ? "" : who + " is neither a robot's id nor an address";
      });
  add("unban", "Take back a ban",
      [](const Order& given) { return change_ban(given, "unban", false); })
      ->add_option("WHO", order.robot, "As it was given to ban")
      ->required();
  add("audit", "Who asked the gateway for what, from the journal", [](const Order& given) {
    const auto entries = read_audit(given.robot);
    std::cout << (given.json ? control::to_line(entries) : audit_text(entries));
    return 0;
  })->add_option("--robot", order.robot, "Only what is about this robot");
  CLI::App* key = app.add_subcommand("key", "Robots' keys for DTLS");
  key->require_subcommand(1);
  add_to(*key, "list", "Which robots have a key",
         [](const Order& given) { return print_keys(given, list_keys(installation_of(given))); });
  add_to(*key, "add", "Make a key for a robot and show it, once",
         [](const Order& given) { return change_key(given, "key add", true); })
      ->add_option("ROBOT", order.robot, "Its id or MQTT-SN client id")
      ->required();
  add_to(*key, "remove", "End the robot's key and connection",
         [](const Order& given) { return change_key(given, "key remove", false); })
      ->add_option("ROBOT", order.robot, "As key add had it, or as key list shows it")
      ->required();
  add_with_file("report", "What support needs to see, without secrets", [](const Order& given) {
    return print_words(given, report(installation_of(given), given.socket, given.file));
  });
}

}  // namespace slamgw::ctl
