// SPDX-License-Identifier: Apache-2.0
#include "tests/support/free_port.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ip/udp.hpp>
#include <filesystem>
#include <random>
#include <stdexcept>
#include <string>

namespace slamgw::test {
namespace {

using boost::asio::ip::tcp;
using boost::asio::ip::udp;

/// Below the ephemeral ports of Linux (from 32768), which any socket may get, and below the ports
/// that tests/soak/program.py draws.
constexpr std::uint16_t first_port = 10000;
constexpr std::uint16_t last_port = 19999;

/// Reserves the port among the test processes of this user, until this process ends.
bool reserve(std::uint16_t port) {
  const auto directory = std::filesystem::temp_directory_path() /
                         ("slam-gateway-test-ports-" + std::to_string(::geteuid()));
  std::filesystem::create_directories(directory);
  const int fd =
      ::open((directory / std::to_string(port)).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (fd < 0) throw std::runtime_error("cannot write to " + directory.string());
  if (::flock(fd, LOCK_EX | LOCK_NB) == 0) return true;
  ::close(fd);
  return false;
}

template <typename Socket, typename Endpoint>
bool binds(const Endpoint& endpoint) {
  boost::asio::io_context io;
  Socket socket(io, endpoint.protocol());
  boost::system::error_code error;
  socket.bind(endpoint, error);
  return !error;
}

std::uint16_t free_port(bool (*is_free)(std::uint16_t)) {
  static std::mt19937 random{std::random_device{}()};
  std::uniform_int_distribution<std::uint16_t> any(first_port, last_port);
  for (int tries = 0; tries < 10000; ++tries) {
    const std::uint16_t port = any(random);
    if (is_free(port) && reserve(port)) return port;
  }
  throw std::runtime_error("no port is free");
}

}  // namespace

std::uint16_t free_tcp_port() {
  return free_port([](std::uint16_t port) {
    return binds<tcp::socket>(tcp::endpoint(boost::asio::ip::address_v4::loopback(), port));
  });
}

std::uint16_t free_udp_port() {
  return free_port(
      [](std::uint16_t port) { return binds<udp::socket>(udp::endpoint(udp::v6(), port)); });
}

}  // namespace slamgw::test
