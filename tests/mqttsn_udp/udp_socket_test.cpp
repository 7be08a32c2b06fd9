// SPDX-License-Identifier: Apache-2.0
// Which sockets of an earlier process are taken over: those that are bound as a new one would be.
#include "adapters/mqttsn_udp/io/udp_socket.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/mqttsn_udp/thread_network.hpp"

namespace slamgw::mqttsn {
namespace {

class KeptSocket : public ThreadNetwork {
 protected:
  /// Whether a socket that was made for the first is used for the second.
  bool is_used(const std::string& listen, const std::string& interface,
               const std::string& new_listen, const std::string& new_interface) {
    const int kept = dup(UdpSocket(io, listen, interface).descriptor());
    return UdpSocket(io, new_listen, new_interface, kept).is_taken_over();
  }

  boost::asio::io_context io;
};

TEST_F(KeptSocket, IsUsedWhenNothingHasChanged) {
  for (const std::string listen : {"[::]:47193", "127.0.0.1:47193", "0.0.0.0:47193", "[::1]:1"}) {
    EXPECT_TRUE(is_used(listen, "", listen, "")) << listen;
    EXPECT_TRUE(is_used(listen, "lo", listen, "lo")) << listen;
  }
}

TEST_F(KeptSocket, IsNotUsedForAnotherAddressPortFamilyOrInterface) {
  EXPECT_FALSE(is_used("[::]:47193", "", "[::]:47194", ""));
  EXPECT_FALSE(is_used("[::]:47193", "", "[::1]:47193", ""));
  EXPECT_FALSE(is_used("[::]:47193", "", "0.0.0.0:47193", ""));
  EXPECT_FALSE(is_used("0.0.0.0:47193", "", "127.0.0.1:47193", ""));
  EXPECT_FALSE(is_used("[::]:47193", "", "[::]:47193", "wpan0"));
  EXPECT_FALSE(is_used("[::]:47193", "wpan0", "[::]:47193", ""));
  EXPECT_FALSE(is_used("[::]:47193", "wpan0", "[::]:47193", "eth0"));
}

TEST_F(KeptSocket, IsNotUsedWhenItsInterfaceWasMadeAgain) {
  const int kept = dup(UdpSocket(io, "[::]:47193", "wpan0").descriptor());
  remake("wpan0");
  UdpSocket socket(io, "[::]:47193", "wpan0", kept);
  EXPECT_FALSE(socket.is_taken_over());
  EXPECT_EQ(socket.port(), 47193);
}

TEST_F(KeptSocket, IsNotUsedWhenItIsNoUdpSocket) {
  const int tcp = ::socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
  EXPECT_FALSE(UdpSocket(io, "[::]:47193", "", tcp).is_taken_over());
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  EXPECT_FALSE(UdpSocket(io, "[::]:47193", "", ends[0]).is_taken_over());
  close(ends[1]);
}

}  // namespace
}  // namespace slamgw::mqttsn
