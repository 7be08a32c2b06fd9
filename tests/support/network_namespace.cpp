// SPDX-License-Identifier: Apache-2.0
#include "tests/support/network_namespace.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

#include <cstdlib>
#include <stdexcept>

namespace slamgw::test {
namespace {

int open_current() { return open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC); }

void enter(int descriptor) {
  if (setns(descriptor, CLONE_NEWNET) != 0) throw std::runtime_error("can't change namespace");
}

}  // namespace

std::unique_ptr<NetworkNamespace> NetworkNamespace::make() {
  const int home = open_current();
  if (home < 0 || unshare(CLONE_NEWNET) != 0) {
    close(home);
    return nullptr;
  }
  std::unique_ptr<NetworkNamespace> made(new NetworkNamespace(open_current()));
  enter(home);
  close(home);
  made->ip("link set lo up");
  return made;
}

NetworkNamespace::~NetworkNamespace() { close(descriptor_); }

NetworkNamespace::Visit::Visit(const NetworkNamespace& where) : home_(open_current()) {
  enter(where.descriptor_);
}

NetworkNamespace::Visit::~Visit() {
  enter(home_);
  close(home_);
}

void NetworkNamespace::ip(const std::string& arguments) const {
  const Visit visit(*this);  // children start where their parent thread is
  const std::string command = "ip " + arguments;
  if (std::system(command.c_str()) != 0) throw std::runtime_error("failed: " + command);
}

std::string NetworkNamespace::path() const {
  return fmt::format("/proc/{}/fd/{}", getpid(), descriptor_);
}

}  // namespace slamgw::test
