// SPDX-License-Identifier: Apache-2.0
// Sockets that are taken over from an earlier process, two sockets at one port, and datagrams that
// are sent together.
#include "adapters/mqttsn_udp/io/udp_socket.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <numeric>

#include "daemon/config/parse.hpp"
#include "tests/config/fake_files.hpp"
#include "tests/mqttsn_udp/io/thread_network.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::mqttsn {
namespace {

class KeptSocket : public ThreadNetwork {
 protected:
  bool is_used(const std::string& listen, const std::string& interface) {
    const int kept = dup(UdpSocket(io, listen, interface).descriptor());
    return UdpSocket(io, listen, interface, kept).is_taken_over();
  }

  boost::asio::io_context io;
};

TEST_F(KeptSocket, IsUsedWhenNothingHasChanged) {
  for (const std::string listen : {"[::]:47193", "127.0.0.1:47193", "0.0.0.0:47193", "[::1]:1"}) {
    EXPECT_TRUE(is_used(listen, "")) << listen;
    EXPECT_TRUE(is_used(listen, "lo")) << listen;
  }
}

TEST_F(KeptSocket, IsNotUsedWhenItsInterfaceWasRecreated) {
  const int kept = dup(UdpSocket(io, "[::]:47193", "wpan0").descriptor());
  remake("wpan0");
  UdpSocket socket(io, "[::]:47193", "wpan0", kept);
  EXPECT_FALSE(socket.is_taken_over());
  EXPECT_EQ(socket.port(), 47193);
}

/// Returns whether a second socket can be opened at the port of the first. Tries several ports,
/// because another program may use the second address at one of them.
bool both_open(const std::string& first, const std::string& second, std::uint16_t& port) {
  boost::asio::io_context io;
  for (int attempt = 0; attempt < 3; ++attempt) try {
      const UdpSocket socket(io, first + ":0", "");
      port = socket.port();
      const UdpSocket other(io, fmt::format("{}:{}", second, port), "");
      return true;
    } catch (const std::runtime_error& error) {
      EXPECT_NE(std::string(error.what()).find("Address already in use"), std::string::npos)
          << error.what();
    }
  return false;
}

/// Returns whether the configuration may name both addresses, in one list and in two.
bool both_allowed(const std::string& first, const std::string& second, std::uint16_t port) {
  test::FakeFiles files;
  files.files["keys"] = {R"({"r1": "00112233445566778899aabbccddeeff"})", 0600};
  const auto is_allowed = [&](const char* form) {
    const std::string text = fmt::format(fmt::runtime(form), first, second, port);
    return parse_config({{"g.json", text}}, {"pi", ""}, files).problems.empty();
  };
  const bool in_one_list = is_allowed(R"({{"mqttsn": {{"listen": ["{0}:{2}", "{1}:{2}"]}}}})");
  const bool in_two_lists =
      is_allowed(R"({{"mqttsn": {{"listen": ["{0}:{2}"],)"
                 R"( "dtls": {{"keys_file": "keys", "listen": ["{1}:{2}"]}}}}}})");
  EXPECT_EQ(in_one_list, in_two_lists) << first << " " << second;
  return in_two_lists;
}

TEST(TwoUdpSockets, AreConfiguredAtOnePortExactlyWhenTheKernelOpensBoth) {
  const char* const addresses[] = {"[::]",    "[::0]",     "[::1]",    "[0::1]",
                                   "0.0.0.0", "127.0.0.1", "127.0.0.2"};
  std::size_t opened = 0;
  std::uint16_t port = 0;
  for (const std::string first : addresses) {
    for (const std::string second : addresses) {
      const bool do_open = both_open(first, second, port);
      EXPECT_EQ(both_allowed(first, second, port), do_open) << first << " " << second;
      if (do_open) ++opened;
    }
  }
  EXPECT_EQ(opened, 14U) << "IPv4 beside one IPv6 address, and two addresses of IPv4";
}

TEST(TwoUdpSockets, MayLeaveThePortToTheKernel) { EXPECT_TRUE(both_allowed("[::]", "0.0.0.0", 0)); }

/// A socket that sends to another one on the same loop.
class SentTogether : public ::testing::Test {
 protected:
  void SetUp() override {
    receiver->start([this](const UdpSocket::Datagram& datagram) {
      arrived.push_back(datagram.bytes.empty() ? -1 : datagram.bytes.front());
    });
  }
  void send_soon(std::uint8_t first, std::size_t octets = 1, std::uint32_t interface = 0) {
    sender->send_soon({loopback, receiver->port()}, {{}, interface}, Bytes(octets, first));
  }
  void run_until(std::size_t count) {
    EXPECT_TRUE(test::eventually([&] {
      io.poll();
      return arrived.size() >= count;
    }));
  }

  static constexpr IpAddress loopback{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 127, 0, 0, 1};
  boost::asio::io_context io;
  std::shared_ptr<UdpSocket> sender = std::make_shared<UdpSocket>(io, "[::]:0", "");
  std::shared_ptr<UdpSocket> receiver = std::make_shared<UdpSocket>(io, "127.0.0.1:0", "");
  std::vector<int> arrived;
};

TEST_F(SentTogether, ArriveInOrder) {
  for (std::uint8_t i = 0; i < 200; ++i) send_soon(i);
  run_until(200);
  std::vector<int> all(200);
  std::iota(all.begin(), all.end(), 0);
  EXPECT_EQ(arrived, all);
}

TEST_F(SentTogether, LoseOnlyDatagramsThatTheKernelRefuses) {
  constexpr std::size_t too_long = 70000;
  send_soon(1);
  send_soon(2, too_long);
  send_soon(3);
  send_soon(4, too_long);
  run_until(2);
  EXPECT_EQ(arrived, (std::vector<int>{1, 3}));
  EXPECT_EQ(sender->counts().sends_failed, 2u);
}

TEST_F(SentTogether, ArriveWithoutAnInterfaceThatIsGone) {
  constexpr std::uint32_t no_such_interface = 4711;
  send_soon(1, 1, no_such_interface);
  send_soon(2);
  run_until(2);
  EXPECT_EQ(arrived, (std::vector<int>{1, 2}));
  EXPECT_EQ(sender->counts().sends_failed, 0u);
}

TEST_F(SentTogether, LeaveBeforeTheSocketCloses) {
  send_soon(1);
  sender->close();
  run_until(1);
  EXPECT_EQ(sender->counts().sends_failed, 0u);
}

/// Answers to datagrams that arrive together leave in one system call after the last of them.
TEST_F(SentTogether, AnswersLeaveAfterTheLastDatagramOfABatch) {
  const auto server = std::make_shared<UdpSocket>(io, "127.0.0.1:0", "");
  std::vector<std::size_t> left_after;  // answers that had left after each datagram
  const auto count_left = [&] {
    std::uint8_t octet = 0;
    std::size_t count = 0;
    while (recv(receiver->descriptor(), &octet, 1, MSG_DONTWAIT) >= 0) ++count;
    return count;
  };
  server->start([&](const UdpSocket::Datagram& datagram) {
    server->send_soon({loopback, receiver->port()}, {}, Bytes{datagram.bytes.front()});
    left_after.push_back(count_left());
  });
  for (std::uint8_t i = 0; i < 3; ++i) sender->send({loopback, server->port()}, {}, Bytes{i});
  EXPECT_TRUE(test::eventually(io, [&] { return left_after.size() == 3; }));
  EXPECT_EQ(left_after, (std::vector<std::size_t>{0, 0, 0}));
  EXPECT_TRUE(test::eventually([&] { return count_left() == 3; }));
}

}  // namespace
}  // namespace slamgw::mqttsn
