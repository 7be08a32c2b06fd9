// SPDX-License-Identifier: Apache-2.0
#include "tests/support/mosquitto.hpp"

#include <fmt/format.h>
#include <signal.h>

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <cstdio>
#include <sstream>
#include <stdexcept>

#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"

namespace slamgw::test {
namespace {

bool accepts_connections(std::uint16_t port) {
  boost::asio::io_context io;
  boost::asio::ip::tcp::socket socket(io);
  boost::system::error_code error;
  socket.connect({boost::asio::ip::address_v4::loopback(), port}, error);
  return !error;
}

/// The ports of the lines "listener PORT ...".
std::vector<std::uint16_t> listening_ports(const std::string& configuration) {
  std::vector<std::uint16_t> ports;
  std::istringstream lines(configuration);
  for (std::string line; std::getline(lines, line);) {
    unsigned port = 0;
    if (std::sscanf(line.c_str(), "listener %u", &port) == 1) {
      ports.push_back(static_cast<std::uint16_t>(port));
    }
  }
  return ports;
}

void run(const std::vector<std::string>& arguments) {
  ChildProcess process(arguments);
  if (process.wait() != 0) throw std::runtime_error(arguments[0] + " failed");
}

}  // namespace

Mosquitto::Mosquitto(std::string extra_configuration, const std::string& user,
                     const std::string& password)
    : port_(free_tcp_port()) {
  std::string configuration = fmt::format(
      "listener {} 127.0.0.1\nallow_anonymous {}\nset_tcp_nodelay true\nmax_queued_messages "
      "0\n{}\n",
      port_, user.empty(), extra_configuration);
  if (!user.empty()) {
    run({"mosquitto_passwd", "-b", "-c", directory_ / "passwords", user, password});
    configuration += fmt::format("password_file {}\n", directory_ / "passwords");
  }
  // Root's Mosquitto becomes the user of this name, which must be able to read the password file.
  configuration += "user root\n";
  write_file(directory_ / "mosquitto.conf", configuration);
  listeners_ = listening_ports(configuration);
  start();
}

void Mosquitto::start() {
  process_ = std::make_unique<ChildProcess>(
      std::vector<std::string>{"mosquitto", "-c", directory_ / "mosquitto.conf"}, std::string(),
      directory_ / "log");
  const auto listens = [this] {
    return std::ranges::all_of(listeners_, accepts_connections) || !process_->is_running();
  };
  if (!eventually(listens) || !process_->is_running()) {
    throw std::runtime_error("mosquitto does not start: " + read_file(directory_ / "log"));
  }
}

void Mosquitto::kill() { process_.reset(); }
void Mosquitto::pause() { process_->send_signal(SIGSTOP); }
void Mosquitto::reload() { process_->send_signal(SIGHUP); }
void Mosquitto::resume() { process_->send_signal(SIGCONT); }

std::string Mosquitto::uri() const { return fmt::format("mqtt://127.0.0.1:{}", port_); }

Subscriber::Subscriber(const Mosquitto& broker, const std::string& filter,
                       const std::string& format, const std::string& version,
                       const std::vector<std::string>& more) {
  // With -d the program prints SUBACK. Messages are the lines that begin with MSG.
  std::vector<std::string> command = more;
  command.insert(command.begin(), {"stdbuf", "-oL", "mosquitto_sub", "-d", "-h", "127.0.0.1", "-p",
                                   std::to_string(broker.port()), "-V", version, "-q", "1", "-t",
                                   filter, "-F", "MSG " + format});
  process_ = std::make_unique<ChildProcess>(command, directory_ / "out", directory_ / "err");
  if (!eventually(
          [this] { return read_file(directory_ / "out").find("SUBACK") != std::string::npos; })) {
    throw std::runtime_error("mosquitto_sub does not subscribe: " + read_file(directory_ / "err"));
  }
}

std::vector<std::string> Subscriber::lines() const {
  std::vector<std::string> lines;
  std::istringstream text(read_file(directory_ / "out"));
  for (std::string line; std::getline(text, line);) {
    if (line.starts_with("MSG ")) lines.push_back(line.substr(4));
  }
  return lines;
}

void mosquitto_publish(const Mosquitto& broker, const std::vector<std::string>& arguments) {
  std::vector<std::string> command{"mosquitto_pub", "-h", "127.0.0.1", "-p",
                                   std::to_string(broker.port())};
  command.insert(command.end(), arguments.begin(), arguments.end());
  run(command);
}

}  // namespace slamgw::test
