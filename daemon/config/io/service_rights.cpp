// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/io/service_rights.hpp"

#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <vector>

namespace slamgw {
namespace {

std::vector<gid_t> groups_of(const passwd& user) {
  int count = 64;  // more than a service's user has; else the loop below asks for the right number
  std::vector<gid_t> groups(static_cast<std::size_t>(count));
  while (getgrouplist(user.pw_name, user.pw_gid, groups.data(), &count) < 0)
    groups.resize(static_cast<std::size_t>(count));
  groups.resize(static_cast<std::size_t>(count));
  return groups;
}

/// Runs in the child process, where only some calls are safe after fork().
[[noreturn]] void open_as(uid_t user, gid_t group, const std::vector<gid_t>& groups,
                          const char* path) {
  const bool is_user =
      setgroups(groups.size(), groups.data()) == 0 && setgid(group) == 0 && setuid(user) == 0;
  const bool is_denied =
      is_user && open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK) < 0 && errno == EACCES;
  _exit(is_denied ? 1 : 0);
}

}  // namespace

bool may_user_read(const std::string& user, const std::string& path) {
  if (geteuid() != 0) return true;
  const passwd* const found = getpwnam(user.c_str());
  if (found == nullptr) return true;
  const uid_t uid = found->pw_uid;
  const gid_t gid = found->pw_gid;
  const std::vector<gid_t> groups = groups_of(*found);
  const pid_t child = fork();
  if (child < 0) return true;
  if (child == 0) open_as(uid, gid, groups, path.c_str());
  int status = 0;
  while (waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return true;
  return !WIFEXITED(status) || WEXITSTATUS(status) == 0;
}

}  // namespace slamgw
