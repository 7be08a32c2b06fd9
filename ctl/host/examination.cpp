// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/examination.hpp"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <fstream>
#include <map>
#include <span>
#include <sstream>

#include "ctl/text.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

constexpr int search_attempts = 3;
constexpr std::array<std::uint8_t, 3> searchgw{0x03, 0x01, 0x00};  // MQTT-SN 1.2 section 5.4.2
constexpr std::uint8_t gwinfo_type = 0x02;

std::string numeric(int family, const void* address) {
  std::array<char, INET6_ADDRSTRLEN> text{};
  return inet_ntop(family, address, text.data(), text.size()) ? text.data() : "";
}

/// `/proc/net/igmp6`: index, interface, group as 32 hex digits, ...
void add_ipv6_groups(std::map<std::string, InterfaceFacts>& interfaces) {
  std::ifstream file("/proc/net/igmp6");
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string index, name, digits;
    if (!(words >> index >> name >> digits) || digits.size() != 2 * sizeof(in6_addr)) continue;
    in6_addr group{};
    for (std::size_t i = 0; i < sizeof group; ++i)
      std::from_chars(&digits[2 * i], &digits[2 * i] + 2, group.s6_addr[i], 16);
    interfaces[name].multicast_groups.push_back(numeric(AF_INET6, &group));
  }
}

/// `/proc/net/igmp`: a line with the interface's name, then indented ones with a group each, as hex
/// digits of the host's byte order.
void add_ipv4_groups(std::map<std::string, InterfaceFacts>& interfaces) {
  std::ifstream file("/proc/net/igmp");
  std::string name;
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string first, second;
    words >> first >> second;
    if (!line.starts_with('\t')) {
      name = second;
      continue;
    }
    in_addr group{};
    const auto [end, error] =
        std::from_chars(first.data(), first.data() + first.size(), group.s_addr, 16);
    if (error == std::errc{}) interfaces[name].multicast_groups.push_back(numeric(AF_INET, &group));
  }
}

std::vector<InterfaceFacts> read_interfaces() {
  std::map<std::string, InterfaceFacts> interfaces;
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return {};
  for (const ifaddrs* entry = list; entry; entry = entry->ifa_next) {
    InterfaceFacts& facts = interfaces[entry->ifa_name];
    facts.is_up = (entry->ifa_flags & IFF_UP) != 0;
    if (!entry->ifa_addr) continue;
    if (entry->ifa_addr->sa_family == AF_INET6)
      facts.addresses.push_back(
          numeric(AF_INET6, &reinterpret_cast<const sockaddr_in6*>(entry->ifa_addr)->sin6_addr));
    if (entry->ifa_addr->sa_family == AF_INET)
      facts.addresses.push_back(
          numeric(AF_INET, &reinterpret_cast<const sockaddr_in*>(entry->ifa_addr)->sin_addr));
  }
  freeifaddrs(list);
  add_ipv6_groups(interfaces);
  add_ipv4_groups(interfaces);
  std::vector<InterfaceFacts> result;
  for (auto& [name, facts] : interfaces) {
    facts.name = name;
    result.push_back(std::move(facts));
  }
  return result;
}

/// Of `/proc/<process>/limits`: "Max open files   soft   hard   files".
std::optional<std::uint64_t> open_file_limit(const fs::path& process) {
  constexpr std::string_view title = "Max open files";
  std::ifstream file(process / "limits");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with(title)) continue;
    std::uint64_t soft = 0;
    if (std::istringstream(line.substr(title.size())) >> soft) return soft;
  }
  return std::nullopt;
}

LocalBrokers find_brokers() {
  LocalBrokers brokers;
  std::error_code error;
  for (fs::directory_iterator entry("/proc", error), end; entry != end; entry.increment(error)) {
    std::ifstream file(entry->path() / "comm");
    std::string name;
    if (!std::getline(file, name)) continue;
    if (name == "mosquitto") {
      const auto files = open_file_limit(entry->path());
      if (files)
        brokers.mosquitto_files = std::min(*files, brokers.mosquitto_files.value_or(*files));
    }
    if (name != "beam.smp") continue;  // what Erlang programs run in
    std::ifstream arguments(entry->path() / "cmdline");
    std::string text;
    std::getline(arguments, text);
    if (text.find("ejabberd") != text.npos) brokers.has_ejabberd = true;
  }
  return brokers;
}

/// The port of the first address that every interface of one family listens on; searches are sent
/// there over loopback.
std::optional<sockaddr_in6> search_target(const mqttsn::Settings& settings) {
  if (!settings.enabled || !settings.interface.empty()) return std::nullopt;
  for (const std::string& listen : settings.listen) {
    if (!listen.starts_with("[::]:")) continue;
    std::uint16_t port = 0;
    std::from_chars(listen.data() + 5, listen.data() + listen.size(), port);
    sockaddr_in6 target{};
    target.sin6_family = AF_INET6;
    target.sin6_addr = in6addr_loopback;
    target.sin6_port = htons(port);
    return target;
  }
  return std::nullopt;
}

std::optional<bool> search(const mqttsn::Settings& settings) {
  const auto target = search_target(settings);
  if (!target) return std::nullopt;
  const int udp = socket(AF_INET6, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (udp < 0) return std::nullopt;
  timeval second{1, 0};
  setsockopt(udp, SOL_SOCKET, SO_RCVTIMEO, &second, sizeof second);
  bool is_answered = false;
  for (int i = 0; i < search_attempts && !is_answered; ++i) {
    sendto(udp, searchgw.data(), searchgw.size(), 0, reinterpret_cast<const sockaddr*>(&*target),
           sizeof *target);
    std::array<std::uint8_t, 64> answer{};
    const ssize_t size = recv(udp, answer.data(), answer.size(), 0);
    is_answered = size >= 3 && answer[1] == gwinfo_type;
  }
  close(udp);
  return is_answered;
}

/// An entry of `mqttsn.listen`, ADDRESS:PORT or [ADDRESS]:PORT, can't be bound because something
/// else is bound there.
bool is_taken(std::string address, const std::string& port) {
  if (address.starts_with('[') && address.ends_with(']'))
    address = address.substr(1, address.size() - 2);
  addrinfo hints{};
  hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(address.c_str(), port.c_str(), &hints, &found) != 0) return false;
  const int udp = socket(found->ai_family, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  const bool is_taken =
      udp >= 0 && bind(udp, found->ai_addr, found->ai_addrlen) != 0 && errno == EADDRINUSE;
  if (udp >= 0) close(udp);
  freeaddrinfo(found);
  return is_taken;
}

/// The first port of these entries of `mqttsn.listen` that another program has.
std::optional<std::uint16_t> taken_port(std::span<const std::string> entries) {
  for (const std::string& listen : entries) {
    const std::size_t colon = listen.rfind(':');
    const std::string port = listen.substr(colon + 1);
    if (!is_taken(listen.substr(0, colon), port)) continue;
    std::uint16_t number = 0;
    std::from_chars(port.data(), port.data() + port.size(), number);
    return number;
  }
  return std::nullopt;
}

/// Between two starts of the service, systemd keeps so many of its UDP sockets open
/// (FileDescriptorStoreMax=): those of the first entries of `mqttsn.listen`.
std::size_t count_kept_sockets() {
  const ProgramResult shown =
      run_program({"systemctl", "show", "-P", "NFileDescriptorStore", service_unit});
  std::size_t count = 0;
  if (shown.status == 0)
    std::from_chars(shown.output.data(), shown.output.data() + shown.output.size(), count);
  return count;
}

/// The first of the journal's entries as JSON, as `time: text`; empty when there is none.
std::string dated_line(const std::string& text) {
  const auto entry = nlohmann::json::parse(text.substr(0, text.find('\n')), nullptr, false);
  const std::string digits = text_at(entry, "__REALTIME_TIMESTAMP");  // microseconds
  std::int64_t microseconds = 0;
  std::from_chars(digits.data(), digits.data() + digits.size(), microseconds);
  const std::string message = text_at(entry, "MESSAGE");
  if (message.empty()) return {};
  return to_iso8601(WallTime(std::chrono::microseconds(microseconds))) + ": " + message;
}

std::optional<bool> clock_state() {
  const ProgramResult shown =
      run_program({"timedatectl", "show", "-p", "NTPSynchronized", "--value"});
  if (shown.status != 0) return std::nullopt;
  return shown.output.starts_with("yes");
}

}  // namespace

HostFacts gather_facts(const Installation& installation, const std::string& socket) {
  HostFacts facts;
  facts.configuration = installation.parsed();
  facts.own_version = SLAMGW_VERSION;
  try {
    Connection connection(socket);
    facts.status = connection.ask({{"command", "status"}}, answer_patience);
    facts.fleet = connection.ask({{"command", "fleet"}}, answer_patience);
  } catch (const NotRunning& failure) {
    facts.is_running = false;
    facts.status_failure = failure.what();
  } catch (const Failure& failure) {
    facts.status_failure = failure.what();
  }
  facts.interfaces = read_interfaces();
  std::array<char, 256> name{};  // POSIX's longest host name and a NUL
  if (gethostname(name.data(), name.size() - 1) == 0) facts.host_name = name.data();
  facts.brokers = find_brokers();
  const mqttsn::Settings& mqttsn = installation.parsed().config.mqttsn;
  if (facts.is_running) {
    facts.is_search_answered = search(mqttsn);
  } else if (mqttsn.enabled) {
    const std::size_t kept = installation.is_service() ? count_kept_sockets() : 0;
    const std::span<const std::string> entries(mqttsn.listen);
    facts.taken_port = taken_port(entries.subspan(std::min(kept, entries.size())));
  }
  facts.is_clock_synchronised = clock_state();
  std::error_code error;
  const fs::space_info space = fs::space(installation.state(), error);
  if (!error) facts.state_free_bytes = space.available;
  return facts;
}

RobotFacts gather_robot_facts(const std::string& robot, Connection& daemon) {
  RobotFacts facts;
  facts.robots = daemon.ask({{"command", "robots"}}, answer_patience);
  const auto fleet = daemon.ask({{"command", "fleet"}}, answer_patience);
  if (const auto rows = fleet.find("robots"); rows != fleet.end()) facts.fleet_robots = *rows;
  try {
    facts.nodes = daemon.ask({{"command", "ble nodes"}}, answer_patience);
  } catch (const Failure&) {  // without a BLE mesh there are none
  }
  const ProgramResult lines =
      run_program({"journalctl", "-q", "--no-pager", "-u", "slam-gateway", "--since", "-1d", "-n",
                   "1", "-o", "json", "-g", "may not |refuse", "ROBOT_ID=" + robot});
  if (lines.status == 0) facts.refusal = dated_line(lines.output);
  return facts;
}

}  // namespace slamgw::ctl
