// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <vector>

#include "ctl/connection.hpp"
#include "daemon/config/io/load.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

/// A text file of the report, and the program whose output it is.
struct Source {
  const char* name;
  std::vector<std::string> words;
};

const std::vector<Source>& sources() {
  static const std::vector<Source> all{
      {"system.txt", {"sh", "-c", "uname -a; cat /etc/os-release; uptime; free -m; timedatectl"}},
      {"packages.txt",
       {"dpkg-query", "-W", "slam-gateway*", "mosquitto*", "libpaho-mqtt*", "libserialport0",
        "libmosquitto1", "libsqlite3-0", "systemd"}},
      {"service.txt", {"systemctl", "status", "--no-pager", "--full", "-n", "0", service_unit}},
      {"journal.txt",
       {"journalctl", "-u", service_unit, "--since", "-1h", "-o", "short-iso-precise",
        "--no-pager"}},
      {"kernel.txt",
       {"sh", "-c",
        "dmesg --time-format iso 2>&1 | "
        "grep -iE 'usb|tty|802154|6lowpan|wpan|oom|mmc|I/O error' | tail -n 300"}},
      {"boards.txt",
       {"sh", "-c", "ls -l /dev/ttyACM* /dev/ttyUSB* /dev/serial/by-id /dev/slam-gateway; lsusb"}},
      {"network.txt",
       {"sh", "-c",
        "ip -br address; ip -br link; ip maddress; ss -lunp; sysctl net.core.rmem_max"}},
      {"disk.txt",
       {"sh", "-c",
        "df -h / /var/lib/slam-gateway; ls -l /etc/slam-gateway "
        "/etc/slam-gateway/gateway.d /var/lib/slam-gateway"}},
  };
  return all;
}

bool is_secret(std::string key) {
  std::transform(key.begin(), key.end(), key.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const char* const word : {"password", "passwd", "secret", "oob", "token", "credential"})
    if (key.find(word) != std::string::npos && key != "credentials_file" && key != "token_file")
      return true;
  return key == "pass" || key == "key";
}

void hide_secrets(ordered_json& document) {
  for (auto& [key, value] : document.items()) {
    if (value.is_structured()) {
      hide_secrets(value);
    } else if (document.is_object() && is_secret(key) && !value.is_null()) {
      value = "(not shown)";
    }
  }
}

void write(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

std::string read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_configuration(const fs::path& directory, const Installation& installation) {
  std::string text;
  for (const Problem& problem : installation.parsed().problems) text += to_string(problem) + "\n";
  for (const Problem& problem : installation.parsed().notices)
    text += "notice: " + to_string(problem) + "\n";
  for (const Problem& problem : installation.parsed().warnings)
    text += "warning: " + to_string(problem) + "\n";
  write(directory / "check-config.txt", text.empty() ? "OK\n" : text);
  for (const std::string& name : configuration_files(installation.configuration()))
    write(directory / fs::path(name).filename(), without_secrets(read(name)));
}

std::string ask(const std::string& socket, const char* command) {
  try {
    Connection connection(socket);
    return connection.ask({{"command", command}}, answer_patience).dump(2) + "\n";
  } catch (const Failure& failure) {
    return std::string(failure.what()) + "\n";
  }
}

}  // namespace

std::string without_secrets(std::string_view text) {
  ordered_json json = ordered_json::parse(text, nullptr, false, true);
  if (json.is_discarded()) return "(is no JSON; left out, for it may hold secrets)\n";
  hide_secrets(json);
  return json.dump(2) + "\n";
}

std::string report(const Installation& installation, const std::string& socket,
                   const std::string& file) {
  ArchiveFile archive(file);
  const WorkDirectory work;
  const fs::path directory = work.path() / "slam-gateway-report";
  fs::create_directory(directory);
  write(directory / "version.txt", std::string("slam-gatewayctl ") + SLAMGW_VERSION + "\n");
  write_configuration(directory, installation);
  write(directory / "status.json", ask(socket, "status"));
  write(directory / "robots.json", ask(socket, "robots"));
  for (const Source& source : sources())
    write(directory / source.name, run_program(source.words).output);
  run_or_fail({"tar", "-czf", archive.path(), "-C", work.path().string(), "slam-gateway-report"});
  archive.finish();
  return fmt::format(
      "{}: versions, configuration without secrets, status, robots, the journal's last hour, "
      "kernel and boards.\nLook through it before you send it: robots' names, addresses and "
      "messages are in it.\n",
      file);
}

}  // namespace slamgw::ctl
