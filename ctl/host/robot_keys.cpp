// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/robot_keys.hpp"

#include <fmt/format.h>
#include <pwd.h>
#include <qrencode.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <nlohmann/json.hpp>

#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/config/io/service_rights.hpp"
#include "daemon/config/io/system_files.hpp"
#include "daemon/config/key_file.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

fs::path keys_file(const Installation& installation) {
  const auto& file = installation.parsed().config.mqttsn.dtls.keys_file;
  if (file) return fs::absolute(*file).lexically_normal();
  throw Failure(
      fmt::format("robots have no keys yet: write {{\"mqttsn\": {{\"dtls\": {{\"keys_file\": "
                  "\"robot-keys.json\"}}}}}} into {}, then type this again",
                  (installation.site() / "dtls.json").string()));
}

RobotKeys read_keys(const fs::path& path) {
  const auto file = SystemFiles(service_user).read(path.string());
  if (!file && file.error().is_missing) return {};
  if (!file) throw Failure(fmt::format("{} can't be read: {}", path.string(), file.error().text));
  if (const std::string fault = fault_of_key_file(path.string(), *file); !fault.empty())
    throw Failure(fault);
  Problems problems;
  RobotKeys keys = parse_key_file(file->text, path.string(), problems);
  if (!problems.empty()) throw Failure(to_string(problems.front()));
  return keys;
}

/// Gives the file to the owner of the replaced file, else to the service, which must read it.
void give_to_owner(int file, const fs::path& replaced) {
  if (geteuid() != 0) return;
  struct stat status {};
  const passwd* const service = getpwnam(service_user);
  uid_t owner = service ? service->pw_uid : 0;
  gid_t group = service ? service->pw_gid : 0;
  if (stat(replaced.c_str(), &status) == 0) {
    owner = status.st_uid;
    group = status.st_gid;
  }
  if (fchown(file, owner, group) != 0)
    throw Failure(
        fmt::format("{} can't be given to its owner: {}", replaced.string(), std::strerror(errno)));
}

void write_keys(const fs::path& path, const RobotKeys& keys) {
  NewFile file(path);
  file.write(write_key_file(keys));
  give_to_owner(file.descriptor(), path);
  file.finish();
}

Bytes random_key() {
  Bytes key(min_key_octets);
  if (getrandom(key.data(), key.size(), 0) != static_cast<ssize_t>(key.size()))
    throw Failure(fmt::format("no random number: {}", std::strerror(errno)));
  return key;
}

/// Returns the client id, by which the mesh knows a robot of `robots`; else `robot` itself.
std::string identity_of(const Installation& installation, const std::string& robot) {
  for (const RobotName& name : installation.parsed().config.robots)
    if (name.id == robot && name.mqttsn_client_id) return *name.mqttsn_client_id;
  return robot;
}

/// Returns the identity of the robot's key. Without one, `robot` may also be the client id of a key
/// that stayed behind: no robot of `robots` has this client id any more.
std::string identity_of_key(const Installation& installation, const std::string& robot,
                            const RobotKeys& keys) {
  std::string identity = identity_of(installation, robot);
  const bool is_in_use =
      std::ranges::any_of(installation.parsed().config.robots,
                          [&](const RobotName& name) { return name.mqttsn_client_id == robot; });
  return keys.contains(identity) || is_in_use ? identity : robot;
}

}  // namespace

nlohmann::ordered_json list_keys(const Installation& installation) {
  const fs::path path = keys_file(installation);
  auto robots = nlohmann::json::array();
  for (const auto& [identity, key] : read_keys(path)) robots.push_back(identity);
  return {{"file", path.string()}, {"robots", std::move(robots)}};
}

nlohmann::ordered_json change_keys(const Installation& installation, const std::string& robot,
                                   bool is_added) {
  const fs::path path = keys_file(installation);
  const DirectoryLock lock(path.parent_path());
  RobotKeys keys = read_keys(path);
  const std::string identity =
      is_added ? identity_of(installation, robot) : identity_of_key(installation, robot, keys);
  nlohmann::ordered_json answer{{"file", path.string()}, {"robot", robot}, {"identity", identity}};
  if (is_added) {
    if (!is_valid_level(identity))
      throw Failure("a client id must be one topic level of 1 to 64 octets, without + # /");
    const auto [added, is_new] = keys.emplace(identity, random_key());
    if (!is_new)
      throw Failure(
          fmt::format("{} has a key already; for another one, first type: "
                      "slam-gatewayctl key remove {}",
                      robot, shell_word(robot)));
    answer["key"] = to_hex(added->second);
  } else if (keys.erase(identity) == 0) {
    throw Failure(fmt::format("{} has no key in {}", robot, path.string()));
  }
  write_keys(path, keys);
  return answer;
}

std::string qr_code(const std::string& text) {
  const std::unique_ptr<QRcode, decltype(&QRcode_free)> code(
      QRcode_encodeString8bit(text.c_str(), 0, QR_ECLEVEL_M), &QRcode_free);
  if (!code) return {};
  constexpr int quiet_zone = 4;  // ISO/IEC 18004: modules that readers need around it
  const int width = code->width;
  const auto is_dark = [&](int x, int y) {
    const bool is_inside = x >= 0 && y >= 0 && x < width && y < width;
    return is_inside && (code->data[y * width + x] & 1) != 0;
  };
  std::string lines;
  for (int y = -quiet_zone; y < width + quiet_zone; y += 2) {
    lines += "\x1b[30;107m";
    for (int x = -quiet_zone; x < width + quiet_zone; ++x) {
      const bool upper = is_dark(x, y);
      const bool lower = is_dark(x, y + 1);
      lines += upper && lower ? "█" : upper ? "▀" : lower ? "▄" : " ";
    }
    lines += "\x1b[0m\n";
  }
  return lines;
}

std::string text_of_keys(const nlohmann::ordered_json& answer, bool shows_codes) {
  if (answer.contains("robots")) {
    std::string text;
    for (const std::string name : answer["robots"]) text += name + "\n";
    return text.empty() ? "no robot has a key\n" : text;
  }
  const std::string identity = answer["identity"];
  if (!answer.contains("key")) return fmt::format("{} has no key any more\n", identity);
  const std::string key = answer["key"];
  return fmt::format(
      "PSK identity: {}\nPSK (hex):    {}\n{}Write both into the robot; the key is not shown "
      "again.\n",
      identity, key, shows_codes ? qr_code(identity + "\n" + key) : "");
}

}  // namespace slamgw::ctl
