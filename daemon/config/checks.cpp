// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/checks.hpp"

#include <fmt/format.h>
#include <sys/un.h>

#include <tuple>

#include "daemon/config/rules.hpp"
#include "daemon/core/ip_network.hpp"

namespace slamgw {
namespace {

/// Reports each repetition of a value, at the later key that is in the file. `what` completes
/// "is ... already".
template <class T>
class Unique {
 public:
  Unique(ParseResult& result, std::string what) : result_(result), what_(std::move(what)) {}

  void add(const T& value, const std::string& key) {
    const auto [first, is_new] = first_.emplace(value, key);
    if (is_new) return;
    const bool is_set = result_.is_set(key);
    result_.problem(is_set ? key : first->second,
                    fmt::format("is {} of {} already; each once is allowed", what_,
                                is_set ? first->second : key));
  }

 private:
  ParseResult& result_;
  std::string what_;
  std::map<T, std::string> first_;
};

void require(ParseResult& result, const std::string& group, std::string_view key) {
  const std::string path = fmt::format("{}.{}", group, key);
  if (!result.is_set(path)) result.problem(path, fmt::format("is missing; \"{}\" is needed", key));
}

void check_robots(ParseResult& result) {
  Unique<std::string> ids(result, "the id");
  Unique<std::uint16_t> addresses(result, "the address");
  Unique<std::string> client_ids(result, "the client id");
  const Config& config = result.config;
  if (config.ble_mesh.enabled) addresses.add(config.ble_mesh.address, "ble_mesh.address");
  for (std::size_t i = 0; i < config.robots.size(); ++i) {
    const RobotName& robot = config.robots[i];
    const std::string path = fmt::format("robots[{}]", i);
    require(result, path, "id");
    if (!robot.id.empty()) ids.add(robot.id, path + ".id");
    const auto implied = RobotNames().ble_address_of(robot.id);
    if (implied && implied != robot.ble_address)
      result.problem(path + ".id",
                     fmt::format("is the name of the BLE robot at 0x{:04x}; another id, or that "
                                 "ble_address, is needed",
                                 *implied));
    if (robot.ble_address) addresses.add(*robot.ble_address, path + ".ble_address");
    if (robot.mqttsn_client_id) client_ids.add(*robot.mqttsn_client_id, path + ".mqttsn_client_id");
    if (robot.address && robot.ble_address && !robot.mqttsn_client_id)
      result.problem(path + ".address",
                     "is an address on Thread, where this robot has no name; "
                     "\"mqttsn_client_id\" is needed too");
    if (robot.prefer && (!robot.ble_address || !robot.mqttsn_client_id))
      result.problem(path + ".prefer",
                     "is for a robot on both meshes; \"ble_address\" and \"mqttsn_client_id\" are "
                     "needed");
    if (!result.is_set(path + ".ble_address") && !result.is_set(path + ".mqttsn_client_id") &&
        !result.is_set(path + ".origin") && !result.is_set(path + ".address"))
      result.problem(path,
                     "has no address; \"ble_address\", \"mqttsn_client_id\" or both are "
                     "needed");
  }
}

void check_predefined_topics(ParseResult& result) {
  using Scope = std::pair<std::optional<std::string>, std::uint16_t>;
  Unique<Scope> ids(result, "the id");
  const auto& topics = result.config.mqttsn.predefined_topics;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const std::string path = fmt::format("mqttsn.predefined_topics[{}]", i);
    require(result, path, "id");
    require(result, path, "name");
    if (topics[i].id != 0) ids.add({topics[i].client_id, topics[i].id}, path + ".id");
  }
}

void check_ble_mesh(ParseResult& result) {
  const ble::Settings& ble = result.config.ble_mesh;
  if (ble.will) {
    require(result, "ble_mesh.will", "topic");
    require(result, "ble_mesh.will", "message");
  }
  if (ble.pos_cmd_type == "run")
    result.problem("ble_mesh.types.pos_cmd",
                   "\"run\" is the type of on/off commands; any other type is allowed");
  Unique<std::string> types(result, "the type");
  types.add(ble.min_com_type, "ble_mesh.types.min_com");
  types.add(ble.pos_cmd_type, "ble_mesh.types.pos_cmd");
  types.add(ble.sensor_update_type, "ble_mesh.types.sensor_update");
  if (ble.gateway_group && std::ranges::find(ble.groups, *ble.gateway_group) != ble.groups.end())
    result.problem("ble_mesh.gateway_group",
                   "is in ble_mesh.groups, to which robots are subscribed: they would acknowledge "
                   "each other's messages; any other group is allowed");
  if (ble.radio == ble::RadioChoice::bluez && ble.protocol == ble::Protocol::cobs)
    result.problem("ble_mesh.protocol",
                   "is for a serial board, and \"radio\" is \"bluez\"; only \"nordic-serial\" is "
                   "allowed beside it");
  const bool is_positions_stream =
      ble.protocol == ble::Protocol::cobs && ble.cobs_content == ble::CobsContent::positions;
  if (is_positions_stream && !result.is_set("ble_mesh.robot_id"))
    result.problem("ble_mesh.robot_id",
                   "is missing: this stream does not say whose positions it carries; with "
                   "\"protocol\": \"cobs\" and \"cobs_content\": \"positions\" a robot's id is "
                   "needed");
}

void check_relay(ParseResult& result) {
  const ble::Settings& ble = result.config.ble_mesh;
  if (ble.relay.empty()) return;
  if (ble.protocol == ble::Protocol::cobs)
    result.problem("ble_mesh.relay",
                   "has no effect on this link, which has no way to robots; only \"protocol\": "
                   "\"nordic-serial\" is allowed beside it");
  if (result.config.update_mode == UpdateMode::json)
    result.problem("ble_mesh.relay",
                   "would carry JSON, which robots do not understand; \"positions\" or \"raw\" for "
                   "payload.update is allowed beside it");
  if (ble.relay.size() > 1 && std::ranges::find(ble.relay, "robot/+/update") != ble.relay.end())
    result.problem("ble_mesh.relay",
                   "names robots beside \"robot/+/update\", which has all of them: each update "
                   "would come twice; that filter alone is allowed");
  if (ble.gateway_group == ble.relay_group ||
      std::ranges::find(ble.groups, ble.relay_group) != ble.groups.end())
    result.problem("ble_mesh.relay_group",
                   "is ble_mesh.gateway_group or in ble_mesh.groups, which gateways hear; any "
                   "other group is allowed");
}

/// The address and port of a UDP socket.
struct UdpPlace {
  explicit UdpPlace(const std::string& listen) : is_ipv6(listen.starts_with('[')) {
    std::tie(host, port) = listen_parts(listen);
    const std::size_t percent = std::min(host.find('%'), host.size());
    address = IpNetwork::parse(host.substr(0, percent)).value_or(IpNetwork()).address;
    scope = host.substr(percent);
  }

  bool is_ipv6;
  std::string host;
  std::uint16_t port = 0;
  IpNetwork::Address address{};
  std::string scope;
};

/// Returns why the kernel opens only one of two sockets, in words that may be empty; nothing when
/// it opens both. UdpSocket opens `[::]` for IPv4 too, and other IPv6 addresses for IPv6 only.
std::optional<std::string_view> overlap_of(const UdpPlace& a, const UdpPlace& b) {
  constexpr IpNetwork::Address all_ipv6{};
  constexpr std::string_view all_ipv4 = "0.0.0.0";
  if (a.port != b.port || a.port == 0) return std::nullopt;
  if (a.address == all_ipv6 || b.address == all_ipv6)
    return ", because [::] stands for all IPv6 and IPv4 addresses";
  if (a.is_ipv6 != b.is_ipv6) return std::nullopt;
  if (a.host == all_ipv4 || b.host == all_ipv4)
    return ", because 0.0.0.0 stands for all IPv4 addresses";
  if (a.address != b.address || a.scope != b.scope) return std::nullopt;
  return "";
}

/// Reports each second address at one port, at a key that is in the file.
void check_ports(ParseResult& result) {
  struct Socket {
    std::string key;
    std::string listen;
  };
  std::vector<Socket> sockets;
  const mqttsn::Settings& mqttsn = result.config.mqttsn;
  if (!mqttsn.enabled) return;
  for (const std::string& listen : mqttsn.listen) sockets.push_back({"mqttsn.listen", listen});
  if (mqttsn.dtls.keys_file)
    for (const std::string& listen : mqttsn.dtls.listen)
      sockets.push_back({"mqttsn.dtls.listen", listen});
  std::erase_if(sockets, [](const Socket& each) { return each.listen.empty(); });  // is reported
  for (auto later = sockets.begin(); later != sockets.end(); ++later)
    for (auto earlier = sockets.begin(); earlier != later; ++earlier) {
      const auto overlap = overlap_of(UdpPlace(earlier->listen), UdpPlace(later->listen));
      if (!overlap) continue;
      const auto& [here, there] =
          result.is_set(later->key) ? std::tie(*later, *earlier) : std::tie(*earlier, *later);
      result.problem(here.key, fmt::format("{} takes the port of {} in {}{}; another port, or one "
                                           "of the two, is allowed",
                                           here.listen, there.listen, there.key, *overlap));
    }
}

void check_mqttsn(ParseResult& result) {
  const mqttsn::Settings& mqttsn = result.config.mqttsn;
  if (mqttsn.enabled && mqttsn.listen.empty())
    result.problem("mqttsn.listen",
                   "is empty; at least one address, or \"enabled\": false, is needed");
  if (mqttsn.dtls.keys_file && mqttsn.dtls.listen.empty())
    result.problem("mqttsn.dtls.listen",
                   "is empty; at least one address is needed beside keys_file");
  if (!mqttsn.enabled || !mqttsn.announce) return;
  if (mqttsn.is_auto() || mqttsn.interface == "lo" || mqttsn::is_thread_interface(mqttsn.interface))
    result.problem("mqttsn.announce",
                   fmt::format("has no effect on the LAN, which mqttsn.interface \"{}\" may not "
                               "serve; \"*\" or the name of the LAN's interface is needed there",
                               mqttsn.interface));
  if (mqttsn.require_identity == mqttsn::RequireIdentity::all)
    result.problem(
        "mqttsn.announce",
        "announces the port of plain MQTT-SN, which mqttsn.require_identity \"all\" closes; "
        "false is allowed beside it");
  if (!mqttsn.listens_widely())
    result.problem("mqttsn.announce",
                   "needs an address such as [::]:47193 or 0.0.0.0:47193 in mqttsn.listen");
}

void check_tls_keys(ParseResult& result) {
  const BrokerSettings& broker = result.config.broker;
  for (const NamedFile& file : named_files(result.config))
    if (file.key.starts_with("broker.tls.") && !broker.uses_tls())
      result.problem(file.key, "has no effect without TLS; a broker.uri with mqtts:// is needed");
  if (broker.certificate_file.has_value() == broker.key_file.has_value()) return;
  result.problem(broker.key_file ? "broker.tls.key_file" : "broker.tls.certificate_file",
                 "stands alone; certificate_file and key_file are allowed only together");
}

void check_control_socket(ParseResult& result) {
  constexpr std::size_t longest = sizeof(sockaddr_un::sun_path) - 1;
  if (result.config.control_socket.size() > longest)
    result.problem("control.socket",
                   fmt::format("is too long for a socket; {} bytes are allowed", longest));
}

/// Says what is wrong with a PEM text; empty when it is good.
using PemRule = std::string (Files::*)(const std::string& pem) const;

/// The PEM text when the file is good; nothing when it is not set or a problem was reported.
std::optional<std::string> read_pem(ParseResult& result, const Files& files, const char* key,
                                    const std::optional<std::string>& path, PemRule fault_of,
                                    const char* needed) {
  if (!path) return std::nullopt;
  const auto file = files.read(*path);
  const std::string fault =
      file ? (files.*fault_of)(file->text) : "cannot be read: " + file.error().text;
  if (fault.empty()) return file->text;
  result.problem(
      key, fmt::format("{} {}; {} is needed", *path, fault, file ? needed : "a readable PEM file"));
  return std::nullopt;
}

}  // namespace

void check_relations(ParseResult& result) {
  check_robots(result);
  check_predefined_topics(result);
  check_ble_mesh(result);
  check_relay(result);
  check_mqttsn(result);
  check_ports(result);
  check_tls_keys(result);
  check_control_socket(result);
}

void warn_of_relations(ParseResult& result) {
  const ble::Settings& ble = result.config.ble_mesh;
  if (!ble.enabled || ble.protocol != ble::Protocol::nordic_serial) return;
  if (ble.offline_after > ble::health_interval) return;
  result.warning(
      "presence.offline_after_s",
      fmt::format("is no longer than the {} s between two health messages of a BLE robot: a robot "
                  "that sends nothing else goes offline and online again each time; more than {} "
                  "is needed, the default is {}",
                  ble::health_interval.count(), ble::health_interval.count(),
                  ble::Settings{}.offline_after.count()));
}

void check_tls_files(ParseResult& result, const Files& files) {
  const BrokerSettings& broker = result.config.broker;
  const auto read = [&](const char* key, const auto& path, PemRule fault_of, const char* needed) {
    return read_pem(result, files, key, path, fault_of, needed);
  };
  const char* const certificate_words = "a certificate as PEM";
  read("broker.tls.ca_file", broker.ca_file, &Files::certificate_fault, certificate_words);
  const auto certificate = read("broker.tls.certificate_file", broker.certificate_file,
                                &Files::certificate_fault, certificate_words);
  const auto key = read("broker.tls.key_file", broker.key_file, &Files::key_fault,
                        "a private key without pass phrase as PEM");
  if (certificate && key && !files.key_matches(*certificate, *key))
    result.problem("broker.tls.key_file",
                   "does not belong to certificate_file; its own private key is needed");
}

}  // namespace slamgw
