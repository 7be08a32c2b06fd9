// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/key_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "daemon/config/credentials.hpp"
#include "daemon/config/located_json.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

constexpr const char* keys_file_key = "mqttsn.dtls.keys_file";

std::optional<Bytes> parse_key(std::string_view hex) {
  auto key = from_hex(hex);
  if (!key || key->size() < min_key_octets || key->size() > max_key_octets) return std::nullopt;
  return key;
}

}  // namespace

RobotKeys parse_key_file(const std::string& text, const std::string& file, Problems& problems) {
  RobotKeys keys;
  const auto document = read_group(text, file, R"({"CLIENT ID": "HEX DIGITS", ...})", problems);
  if (!document) return keys;
  const auto add = [&](const std::string& name, std::string wrong) {
    // A name in the form of a key is one, where name and key were exchanged.
    const std::string shown = parse_key(name) ? "(not shown)" : name;
    problems.push_back({file, document->line_of(name), shown, std::move(wrong)});
  };
  for (const auto& [name, value] : document->root.items()) {
    const auto* hex = value.get_ptr<const std::string*>();
    const auto key = hex ? parse_key(*hex) : std::nullopt;
    if (!is_valid_level(name)) {
      add(name, "is not an MQTT-SN client id; allowed: one topic level");
    } else if (!key) {
      add(name, fmt::format("is not a key (not shown: it is secret); allowed: {} to {} hex digits",
                            2 * min_key_octets, 2 * max_key_octets));
    } else {
      keys[name] = *key;
    }
  }
  return keys;
}

std::string write_key_file(const RobotKeys& keys) {
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [identity, key] : keys) json[identity] = to_hex(key);
  return json.dump(2) + "\n";
}

std::string fault_of_key_file(const std::string& path, const FileText& file) {
  const std::string fault = fault_of_secret(path, file, 0077, "type: sudo chmod 600");
  return fault.empty() ? fault : path + " " + fault;
}

namespace {

/// Warns of keys under a robot's id where its client has another id.
void warn_of_unused_keys(ParseResult& result) {
  const std::vector<RobotName>& robots = result.config.robots;
  for (const RobotName& robot : robots) {
    const auto is_client = [&](const RobotName& each) {
      return each.mqttsn_client_id.value_or(each.id) == robot.id;
    };
    if (!result.config.robot_keys.contains(robot.id) || std::ranges::any_of(robots, is_client))
      continue;
    result.warning(keys_file_key,
                   fmt::format("has a key for {}, which no client uses: the MQTT-SN client id of "
                               "this robot is {}; write the key there",
                               robot.id, *robot.mqttsn_client_id));
  }
}

}  // namespace

void read_robot_keys(ParseResult& result, const Files& files) {
  const mqttsn::Settings& mqttsn = result.config.mqttsn;
  const std::optional<std::string>& path = mqttsn.dtls.keys_file;
  if (!path) {
    if (mqttsn.require_identity != mqttsn::RequireIdentity::none)
      result.problem("mqttsn.require_identity",
                     fmt::format("needs robots' keys; {} is needed", keys_file_key));
    return;
  }
  const auto file = files.read(*path);
  if (!file) {
    const char* remedy = file.error().is_missing
                             ? "create it with: sudo slam-gatewayctl key add ROBOT"
                             : "a readable file of keys is needed";
    return result.problem(
        keys_file_key, fmt::format("{} cannot be read: {}; {}", *path, file.error().text, remedy));
  }
  if (std::string fault = fault_of_key_file(*path, *file); !fault.empty())
    return result.problem(keys_file_key, std::move(fault));
  result.config.robot_keys = parse_key_file(file->text, *path, result.problems);
  warn_of_unused_keys(result);
}

}  // namespace slamgw
