// SPDX-License-Identifier: Apache-2.0
#include "ctl/host/archives.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>
#include <utility>
#include <vector>

#include "ctl/connection.hpp"
#include "ctl/show.hpp"
#include "daemon/config/io/load.hpp"
#include "daemon/config/io/service_rights.hpp"
#include "daemon/config/parse.hpp"

namespace slamgw::ctl {
namespace {

namespace fs = std::filesystem;

/// The first member of each archive: its format, and the places of its two trees.
constexpr const char* manifest_name = "slam-gateway-backup.json";
constexpr std::uint64_t archive_format = 1;

struct Manifest {
  std::string configuration;
  fs::path state;
  std::string gateway;  ///< the gateway's id
};

void write_manifest(const fs::path& directory, const Manifest& manifest) {
  const nlohmann::ordered_json json{{"format", archive_format},
                                    {"version", SLAMGW_VERSION},
                                    {"configuration", manifest.configuration},
                                    {"state", manifest.state.string()},
                                    {"gateway", manifest.gateway}};
  std::ofstream(directory / manifest_name) << json.dump(2) << '\n';
}

Manifest read_manifest(const std::string& archive) {
  const ProgramResult read = run_program({"tar", "-xzOf", archive, manifest_name});
  const auto json = nlohmann::json::parse(read.output, nullptr, false);
  const std::uint64_t format = count_at(json, "format");
  if (read.status != 0 || format == 0) throw Failure(archive + " is not a backup of slam-gateway");
  if (format > archive_format)
    throw Failure(fmt::format("{} was written by slam-gateway {}; install that version first",
                              archive, text_at(json, "version")));
  return {string_at(json, "configuration"), string_at(json, "state"), string_at(json, "gateway")};
}

/// Throws Failure unless the archive is of this installation: a foreign archive must not choose
/// which files root writes.
void check_manifest(const std::string& archive, const Manifest& manifest,
                    const Installation& installation) {
  if (manifest.configuration != installation.configuration())
    throw Failure(
        fmt::format("{} is a backup of {}, not of {}; nothing was restored. --config names another "
                    "configuration of yours",
                    archive, manifest.configuration, installation.configuration()));
  if (manifest.state != installation.state())
    throw Failure(fmt::format(
        "{} keeps the state of {}, but the configuration here names {}; nothing was restored. If "
        "the backup is yours, set store.directory in {} first",
        archive, manifest.state.string(), installation.state().string(),
        installation.configuration()));
}

/// Returns the places of the unpacked files. Throws Failure when one is not this installation's.
std::vector<fs::path> targets_of(const std::string& archive, const fs::path& unpacked,
                                 const Installation& installation) {
  std::vector<fs::path> targets;
  for (const auto& entry : fs::recursive_directory_iterator(unpacked)) {
    const fs::path target = "/" / entry.path().lexically_relative(unpacked);
    const fs::file_status status = entry.symlink_status();
    if (fs::is_directory(status) || target == fs::path("/") / manifest_name) continue;
    if (!fs::is_regular_file(status) || entry.hard_link_count() > 1)
      throw Failure(fmt::format(
          "{} holds {}, a link or a device; a backup has files only, so nothing was restored",
          archive, target.string()));
    if (!installation.owns(target))
      throw Failure(fmt::format(
          "{} holds {}, which is not a file of the gateway here; nothing was restored. If the "
          "backup is yours, name the file in {} first, as it was (broker.tls.key_file ...)",
          archive, target.string(), installation.configuration()));
    targets.push_back(target);
  }
  return targets;
}

bool has_same_text(const fs::path& one, const fs::path& other) {
  return run_program({"cmp", "-s", one.string(), other.string()}).status == 0;
}

/// Lists the files that the operator is asked about; empty when no present file would change.
std::string replaced_files(const std::vector<fs::path>& present, const fs::path& unpacked) {
  constexpr std::size_t most = 20;
  std::string text;
  std::size_t count = 0;
  for (const fs::path& file : present)
    if (!has_same_text(file, unpacked / file.relative_path()) && ++count <= most)
      text += "  " + file.string() + "\n";
  if (count > most) text += fmt::format("  and {} more\n", count - most);
  return text;
}

std::string time_suffix() {
  return fmt::format(
      ".before-restore-{:%Y%m%dT%H%M%SZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
}

void make_directories(const fs::path& directory, fs::perms mode) {
  if (directory.empty() || fs::exists(directory)) return;
  make_directories(directory.parent_path(), mode);
  fs::create_directory(directory);
  fs::permissions(directory, mode);
}

void rename_into(const fs::path& from, const fs::path& to, std::error_code& error) {
  make_directories(to.parent_path(), fs::perms::owner_all);
  fs::rename(from, to, error);
}

/// Removes directories that a failed restore leaves empty.
void remove_empty(fs::path directory) {
  std::error_code error;
  while (fs::remove(directory, error)) directory = directory.parent_path();
}

/// The steps of a restore, for undoing them.
struct Steps {
  std::vector<std::pair<fs::path, fs::path>> moved;  ///< present files, and their places aside
  std::vector<fs::path> put;                         ///< files of the archive
};

/// Moves files aside, but not directories, which systemd and the package own. Returns the files'
/// new places in words.
std::string move_aside(const std::vector<fs::path>& present, const Installation& installation,
                       Steps& steps) {
  const std::string suffix = time_suffix();
  std::set<std::string> places;
  for (const fs::path& file : present) {
    const fs::path root = installation.is_state(file) ? installation.state() : installation.etc();
    const fs::path place = file.lexically_relative(root);
    const bool is_elsewhere = place.empty() || *place.begin() == "..";
    fs::path top = (is_elsewhere ? file : root).string() + suffix;
    fs::path aside = is_elsewhere ? top : top / place;
    std::error_code error;
    rename_into(file, aside, error);
    if (error == std::errc::cross_device_link && !is_elsewhere) {  // the root is a mount point
      remove_empty(aside.parent_path());
      top = root / suffix;
      aside = top / place;
      rename_into(file, aside, error);
    }
    if (error) throw fs::filesystem_error("can't move aside", file, aside, error);
    steps.moved.emplace_back(file, aside);
    places.insert(fmt::format("What was in {} is in {} now.\n",
                              (is_elsewhere ? file : root).string(), top.string()));
  }
  return fmt::format("{}", fmt::join(places, ""));
}

/// Returns the file's group if it is a service's, else root: an archive may name no other group.
std::string group_of(const fs::path& unpacked_file) {
  struct stat status {};
  if (stat(unpacked_file.c_str(), &status) != 0) return "root";
  for (const char* const name : {service_user, "slam-gateway-web"})
    if (const group* const known = getgrnam(name); known && known->gr_gid == status.st_gid)
      return name;
  return "root";
}

/// Copies the file with an owner of our own and a mode of at most 0644, whatever the archive says.
void put_in_place(const fs::path& source, const fs::path& target,
                  const Installation& installation) {
  const bool is_state = installation.is_state(target);
  const fs::path directory = target.parent_path();
  if (is_state && installation.is_service() && !fs::exists(directory))
    run_or_fail({"install", "-d", "--mode=0700", fmt::format("--owner={}", service_user),
                 fmt::format("--group={}", service_user), directory.string()});
  make_directories(directory, is_state ? fs::perms::owner_all : static_cast<fs::perms>(0755));
  const unsigned archived = static_cast<unsigned>(fs::status(source).permissions());
  std::vector<std::string> words{
      "install", "-T", fmt::format("--mode={:04o}", is_state ? 0600U : (archived & 0644U) | 0600U)};
  if (installation.is_service()) {
    const bool is_services = is_state || installation.is_key_file(target);
    words.push_back(fmt::format("--owner={}", is_services ? service_user : "root"));
    words.push_back("--group=" + (is_services ? service_user : group_of(source)));
  }
  words.push_back(source.string());
  words.push_back(target.string());
  run_or_fail(words);
}

/// Throws Failure if the way to a file of the state is a link: the service, which owns its state,
/// could have root write elsewhere.
void refuse_links(const fs::path& target, const Installation& installation) {
  if (!installation.is_state(target)) return;
  const fs::path directory = target.parent_path();
  const fs::path state = installation.state();
  if (fs::weakly_canonical(directory) / target.filename() !=
      fs::weakly_canonical(state) / target.lexically_relative(state))
    throw Failure(
        fmt::format("{} is a link, or lies behind one; remove the link, then restore again",
                    directory.string()));
}

/// Brings the files back that were there before a restore failed. Returns the result in words.
std::string undo(const Steps& steps) {
  std::error_code error;
  for (const fs::path& file : steps.put)
    if (fs::is_regular_file(fs::symlink_status(file, error))) fs::remove(file, error);
  std::string lost;
  for (const auto& [file, aside] : steps.moved) {
    fs::rename(aside, file, error);
    if (error)
      lost += fmt::format("\n  move {} to {}", aside.string(), file.string());
    else
      remove_empty(aside.parent_path());
  }
  if (lost.empty()) return "nothing was restored; your files are as before";
  return "nothing was restored, and these files of yours are elsewhere:" + lost;
}

/// Replaces the present files by those of the archive, or throws Failure and changes none. Returns
/// in words where the present files are.
std::string replace_files(const fs::path& unpacked, const std::vector<fs::path>& targets,
                          const Installation& installation) {
  Steps steps;
  try {
    const std::string report = move_aside(installation.files(), installation, steps);
    make_directories(installation.state(), fs::perms::owner_all);
    make_directories(installation.site(), static_cast<fs::perms>(0755));
    for (const fs::path& target : targets) {
      refuse_links(target, installation);
      steps.put.push_back(target);
      put_in_place(unpacked / target.relative_path(), target, installation);
    }
    fs::permissions(installation.state(), fs::perms::owner_all);
    if (installation.is_service())  // -h: changes a link, not the file that it names
      run_or_fail({"chown", "-hR", fmt::format("{}:{}", service_user, service_user),
                   installation.state().string()});
    return report;
  } catch (const std::exception& error) {
    throw Failure(fmt::format("{}\n{}", error.what(), undo(steps)));
  }
}

/// Warns when the gateway's name here differs from the backup's. Under a new name, the gateway uses
/// new topics, and messages retained under the old name stay at the broker.
std::string words_on_new_name(const Manifest& manifest) {
  const std::string now = Installation(manifest.configuration).parsed().config.gateway_id;
  if (manifest.gateway == now) return {};
  return fmt::format(
      "This gateway is called '{}' here, after its host; in the backup it was '{}'. To keep that "
      "name, write\n  {{\"gateway\": {{\"id\": \"{}\"}}}}\ninto {} and type: sudo systemctl "
      "restart slam-gateway\n",
      now, manifest.gateway, manifest.gateway,
      (fs::path(manifest.configuration).replace_extension(".d") / "id.json").string());
}

void need_rights(const Installation& installation, const char* verb) {
  if (installation.is_service() && geteuid() != 0)
    throw Failure(fmt::format("{} needs root; type: sudo slam-gatewayctl {} FILE", verb, verb));
}

/// Returns true if a daemon runs with this configuration. Call while the service is stopped: such a
/// daemon is not the service.
bool is_running_by_hand(const Installation& installation) {
  try {
    const auto status =
        Connection(installation.parsed().config.control_socket).ask({{"command", "status"}});
    return fs::weakly_canonical(string_at(status, "configuration")) ==
           fs::weakly_canonical(installation.configuration());
  } catch (const Silence&) {
    return true;  // it hangs
  } catch (const Failure&) {
    return false;
  }
}

// ---- the report

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
        "libmosquitto1", "systemd"}},
      {"service.txt", {"systemctl", "status", "--no-pager", "--full", "-n", "0", service_unit}},
      {"journal.txt",
       {"sh", "-c",
        fmt::format("journalctl -u {} --since -1h -o short-iso-precise --no-pager 2>&1 | "
                    "tail -c 4000000",  // the newest part; run_program() would keep the oldest
                    service_unit)}},
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

/// Hides the values that the configuration's keys do not allow, and the secrets among the allowed.
/// `path` names `value` as in a problem.
void hide_secrets(ordered_json& value, const std::string& path, const ParseResult& read) {
  const auto is_here = [&path](const Problem& problem) { return problem.key == path; };
  const bool is_refused = std::ranges::any_of(read.problems, is_here);
  if (is_refused || read.secrets.contains(path)) {
    if (!value.is_null()) value = "(not shown)";
  } else if (value.is_array()) {
    for (std::size_t i = 0; i < value.size(); ++i)
      hide_secrets(value[i], fmt::format("{}[{}]", path, i), read);
  } else if (value.is_object()) {
    for (auto& [key, member] : value.items()) {
      const std::string below = path.empty() ? key : path + "." + key;
      if (read.places.contains(below))
        hide_secrets(member, below, read);
      else if (!member.is_null())
        member = "(not shown)";
    }
  }
}

void write_text(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

std::string read_text(const fs::path& path) {
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
  write_text(directory / "check-config.txt", text.empty() ? "OK\n" : text);
  std::error_code error;  // check-config.txt has it
  for (const std::string& name : configuration_files(installation.configuration(), error))
    write_text(directory / fs::path(name).filename(), without_secrets(read_text(name)));
}

std::string ask(const std::string& socket, const char* command) {
  try {
    Connection connection(socket);
    return connection.ask({{"command", command}}).dump(2) + "\n";
  } catch (const Failure& failure) {
    return std::string(failure.what()) + "\n";
  }
}

}  // namespace

std::string backup(const Installation& installation, const std::string& file) {
  need_rights(installation, "backup");
  // With a mistyped --config, the backup would hold the state of the default directory.
  if (access(installation.configuration().c_str(), R_OK) != 0)
    throw Failure(fmt::format("{}: {}; nothing was written", installation.configuration(),
                              std::strerror(errno)));
  if (fs::exists(file)) throw Failure(file + " is there already; name a new file, or remove it");
  const WorkDirectory work;
  write_manifest(work.path(), {installation.configuration(), installation.state(),
                               installation.parsed().config.gateway_id});
  NewFile archive(file);
  std::string missing;
  {
    const ServicePause pause(installation);
    if (is_running_by_hand(installation))
      missing =
          "slam-gatewayd ran during the copy, and not as the service: its last changes may be "
          "missing.\n";
    std::ofstream names(work.path() / "files", std::ios::binary);
    for (const fs::path& path : installation.files())
      names << path.relative_path().string() << '\0';
    names.close();
    constexpr int some_changed = 1;  // GNU tar: "file changed as we read it"
    const ProgramResult packed =
        run_program({"tar", "-czf", archive.path(), "--dereference", "--hard-dereference", "-C",
                     work.path().string(), manifest_name, "-C", "/", "--no-recursion", "--null",
                     "--verbatim-files-from", "-T", work.path() / "files"});
    if (packed.status != 0 && packed.status != some_changed)
      throw Failure(fmt::format("tar failed (status {}): {}", packed.status, packed.output));
    if (packed.status == some_changed && missing.empty())
      missing = "Files changed during the copy: their last changes may be missing.\n";
  }
  archive.give_to_caller();
  archive.finish();
  const std::string words = fmt::format(
      "{}: configuration, credentials, mesh keys, kept messages and sessions ({} bytes).\n", file,
      fs::file_size(file));
  const std::string how =
      installation.is_service() ? "" : "--config " + shell_word(installation.configuration()) + " ";
  return words + missing +
         fmt::format(
             "It holds secrets; only you can read it. Bring it back with: {}slam-gatewayctl "
             "restore {}{}\n",
             geteuid() == 0 ? "sudo " : "", how, shell_word(file));
}

std::string restore(const Installation& installation, const std::string& file,
                    const std::function<bool(const std::string& replaced)>& may_replace) {
  need_rights(installation, "restore");
  if (installation.is_service() && getpwnam(service_user) == nullptr)
    throw Failure("there is no user slam-gateway: install the package first, then restore");
  if (access(file.c_str(), R_OK) != 0) throw Failure(file + ": " + std::strerror(errno));
  const Manifest manifest = read_manifest(file);
  check_manifest(file, manifest, installation);
  const WorkDirectory unpacked;  // complete before any present file is touched
  run_or_fail({"tar", "-xzpf", file, "-C", unpacked.path().string()});
  const std::vector<fs::path> targets = targets_of(file, unpacked.path(), installation);
  const std::string replaced = replaced_files(installation.files(), unpacked.path());
  if (!replaced.empty() && !may_replace(replaced))
    throw Failure("nothing was restored; with --yes, restore does not ask");
  std::string report;
  {
    const ServicePause pause(installation);
    if (is_running_by_hand(installation))  // it would overwrite restored files
      throw Failure("stop slam-gatewayd first: it runs at " +
                    installation.parsed().config.control_socket + ", and not as the service");
    report = replace_files(unpacked.path(), targets, installation);
  }
  const bool is_started =
      installation.is_service() &&
      run_program({"systemctl", "start", "--no-block", service_unit}).status == 0;
  return report + words_on_new_name(manifest) +
         (is_started ? "Restored; the service starts now. Look at: sudo slam-gatewayctl doctor\n"
                     : "Restored; start slam-gatewayd now.\n");
}

std::string without_secrets(std::string_view text) {
  ordered_json json = ordered_json::parse(text, nullptr, false, true);
  if (!json.is_object()) return "(not a JSON object; left out, because it may hold secrets)\n";
  hide_secrets(json, {}, parse_keys({"", std::string(text)}));
  return json.dump(2) + "\n";
}

std::string report(const Installation& installation, const std::string& socket,
                   const std::string& file) {
  NewFile archive(file);
  const WorkDirectory work;
  const fs::path directory = work.path() / "slam-gateway-report";
  fs::create_directory(directory);
  write_text(directory / "version.txt", std::string("slam-gatewayctl ") + SLAMGW_VERSION + "\n");
  write_configuration(directory, installation);
  write_text(directory / "status.json", ask(socket, "status"));
  write_text(directory / "robots.json", ask(socket, "robots"));
  for (const Source& source : sources())
    write_text(directory / source.name, run_program(source.words).output);
  run_or_fail({"tar", "-czf", archive.path(), "-C", work.path().string(), "slam-gateway-report"});
  archive.give_to_caller();
  archive.finish();
  return fmt::format(
      "{}: versions, configuration without secrets, status, robots, the journal's last hour, "
      "kernel and boards.\nLook through it before you send it: robots' names, addresses and "
      "messages are in it.\n",
      file);
}

}  // namespace slamgw::ctl
