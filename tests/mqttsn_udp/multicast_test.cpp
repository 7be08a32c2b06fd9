// SPDX-License-Identifier: Apache-2.0
// Discovery by real multicast in a network of the test's own: the gateway's host has the Thread
// interface `wpan0` and a LAN interface `eth0`, their other ends are on a second host with robots.
#include <gtest/gtest.h>
#include <net/if.h>

#include <boost/asio/ip/multicast.hpp>
#include <cstring>

#include "tests/mqttsn_udp/udp_rig.hpp"
#include "tests/support/network_namespace.hpp"

namespace slamgw::mqttsn {
namespace {

using boost::asio::ip::make_address;
using boost::asio::ip::udp;
using test::NetworkNamespace;

constexpr std::uint16_t port = 47193;
constexpr const char* eid = "fd00:db8::1234:5678:9abc:def0";

class Multicast : public testing::Test {
 protected:
  void SetUp() override {
    gateway_host = NetworkNamespace::make();
    robots_host = NetworkNamespace::make();
    if (!gateway_host || !robots_host) GTEST_SKIP() << "no right to make network namespaces";
    connect("wpan0");
    connect("eth0");
    home = std::make_unique<NetworkNamespace::Visit>(*gateway_host);
  }

  /// A cable between the hosts; its ends have the same name.
  void connect(const std::string& name) {
    gateway_host->ip("link add " + name + " type veth peer name " + name + " netns " +
                     robots_host->path());
    const bool is_thread = name == "wpan0";
    for (auto* host : {gateway_host.get(), robots_host.get()}) {
      const std::string n = host == gateway_host.get() ? "1" : "2";
      host->ip("link set " + name + " addrgenmode none");
      host->ip("link set " + name + " up");
      host->ip("addr add fe80::" + n + "/64 dev " + name + " nodad");
      host->ip("addr add " + std::string(is_thread ? "192.0.2." : "198.51.100.") + n + "/24 dev " +
               name);
    }
    if (!is_thread) return;
    gateway_host->ip("addr add fd00:db8::ff:fe00:4400/64 dev wpan0 nodad");  // RLOC
    gateway_host->ip("addr add fd00:db8::ff:fe00:fc10/64 dev wpan0 nodad");  // ALOC
    gateway_host->ip("addr add " + std::string(eid) + "/64 dev wpan0 nodad");
    robots_host->ip("addr add fd00:db8::2/64 dev wpan0 nodad");
  }

  static Settings settings(const std::string& interface = "") {
    Settings settings;
    settings.listen = {"[::]:47193"};
    settings.interface = interface;
    settings.multicast_group = "ff03::1";
    return settings;
  }

  /// A robot's socket on that interface of the other host.
  udp::socket robot(boost::asio::io_context& io, const std::string& interface,
                    const std::string& address, std::uint16_t own_port = 0) {
    const NetworkNamespace::Visit visit(*robots_host);
    const auto ip = make_address(address);
    udp::socket socket(io, ip.is_v6() ? udp::v6() : udp::v4());
    setsockopt(socket.native_handle(), SOL_SOCKET, SO_BINDTODEVICE, interface.data(),
               static_cast<socklen_t>(interface.size()));
    socket.bind({ip, own_port});
    socket.non_blocking(true);
    return socket;
  }

  static void search(udp::socket& from, const std::string& group = "ff03::1") {
    from.send_to(boost::asio::buffer(encode(SearchGw{1})), {make_address(group), port});
  }

  void join(udp::socket& socket, const std::string& interface) {
    const NetworkNamespace::Visit visit(*robots_host);
    const int on = 1;
    setsockopt(socket.native_handle(), IPPROTO_IPV6, IPV6_RECVHOPLIMIT, &on, sizeof on);
    socket.set_option(boost::asio::ip::multicast::join_group(make_address("ff03::1").to_v6(),
                                                             if_nametoindex(interface.c_str())));
  }

  /// Of an ADVERTISE that has come; 0 when there is none.
  static int hop_limit(udp::socket& socket) {
    Bytes octets(100);
    alignas(cmsghdr) std::uint8_t control[128];
    iovec part{octets.data(), octets.size()};
    msghdr header{};
    header.msg_iov = &part;
    header.msg_iovlen = 1;
    header.msg_control = control;
    header.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(socket.native_handle(), &header, MSG_DONTWAIT);
    if (size < 0) return 0;
    EXPECT_EQ(describe_octets(ByteView(octets).first(static_cast<std::size_t>(size))),
              "ADVERTISE gw=1 duration=900");
    int hops = 0;
    for (cmsghdr* c = CMSG_FIRSTHDR(&header); c; c = CMSG_NXTHDR(&header, c)) {
      if (c->cmsg_type == IPV6_HOPLIMIT) std::memcpy(&hops, CMSG_DATA(c), sizeof hops);
    }
    return hops;
  }

  std::unique_ptr<NetworkNamespace> gateway_host;
  std::unique_ptr<NetworkNamespace> robots_host;
  std::unique_ptr<NetworkNamespace::Visit> home;
};

TEST_F(Multicast, R19_HearsSearchesOnEveryInterface) {
  UdpRig rig = UdpRig::as_is(settings());
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::socket on_lan = robot(rig.io, "eth0", "::");
  for (udp::socket* socket : {&on_thread, &on_lan}) {
    search(*socket);
    EXPECT_EQ(receive(rig.io, *socket), "GWINFO gw=1 address=");
  }
}

TEST_F(Multicast, R19_HearsItsOwnInterfaceOnly) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::socket on_lan = robot(rig.io, "eth0", "::");
  search(on_lan);
  search(on_thread);
  EXPECT_EQ(receive(rig.io, on_thread), "GWINFO gw=1 address=");
  EXPECT_EQ(receive(rig.io, on_lan, nullptr, std::chrono::milliseconds(50)), "nothing");
}

TEST_F(Multicast, R19_HearsIpv4GroupsOnASocketForBoth) {
  Settings both = settings();
  both.multicast_group = "239.9.9.9";
  UdpRig rig = UdpRig::as_is(both);
  udp::socket on_lan = robot(rig.io, "eth0", "198.51.100.2");
  udp::endpoint from;
  search(on_lan, "239.9.9.9");
  EXPECT_EQ(receive(rig.io, on_lan, &from), "GWINFO gw=1 address=");
  EXPECT_EQ(from.address(), make_address("198.51.100.1"));
}

TEST_F(Multicast, R16_AnswersASearchFromTheEid) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  udp::endpoint from;
  search(on_thread);
  ASSERT_EQ(receive(rig.io, on_thread, &from), "GWINFO gw=1 address=");
  EXPECT_EQ(from.address(), make_address(eid));
}

TEST_F(Multicast, R17_AnswersFromTheThreadAddressThatWasAsked) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  for (const std::string asked : {eid, "fd00:db8::ff:fe00:4400", "fd00:db8::ff:fe00:fc10"}) {
    udp::socket client = robot(rig.io, "wpan0", "fd00:db8::2");
    client.connect({make_address(asked), port});  // takes answers from there only
    client.send(boost::asio::buffer(encode(Connect{false, true, 1, 60, "r1"})));
    EXPECT_EQ(receive(rig.io, client), "CONNACK code=0") << asked;
  }
}

TEST_F(Multicast, R18_AdvertisesBeyondTheFirstHopOnEveryInterface) {
  for (const std::string interface : {"wpan0", "eth0"}) {
    boost::asio::io_context io;
    udp::socket listener = robot(io, interface, "::", port);
    join(listener, interface);
    UdpRig rig = UdpRig::as_is(settings());
    int hops = 0;
    EXPECT_TRUE(test::eventually(rig.io, [&] { return (hops = hop_limit(listener)) != 0; }));
    EXPECT_GT(hops, 1) << interface;
  }
}

TEST_F(Multicast, R19_ComesBackWithItsInterface) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  gateway_host->ip("link del wpan0");
  const auto is_down = [&] { return !rig.core.links.back().is_up; };
  ASSERT_TRUE(test::eventually(rig.io, is_down));
  connect("wpan0");
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.core.links.back().is_up; }));
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  search(on_thread);
  EXPECT_EQ(receive(rig.io, on_thread), "GWINFO gw=1 address=");
}

TEST_F(Multicast, R19_JoinsAgainOnAnInterfaceThatComesBack) {
  UdpRig rig = UdpRig::as_is(settings());
  gateway_host->ip("link del wpan0");
  connect("wpan0");
  udp::socket on_thread = robot(rig.io, "wpan0", "fd00:db8::2");
  const auto is_answered = [&] {  // as soon as the gateway has seen the interface
    search(on_thread);
    return receive(rig.io, on_thread, nullptr, std::chrono::milliseconds(100)) != "nothing";
  };
  EXPECT_TRUE(test::eventually(is_answered, std::chrono::seconds(8))) << "sooner than by looking";
}

TEST_F(Multicast, KeepsSessionsOverTheLossOfTheInterface) {
  UdpRig rig = UdpRig::as_is(settings("wpan0"));
  std::optional<udp::socket> client = robot(rig.io, "wpan0", "fd00:db8::2", port);
  const udp::endpoint gateway(make_address(eid), port);
  client->send_to(boost::asio::buffer(encode(Connect{false, true, 1, 60, "r1"})), gateway);
  ASSERT_EQ(receive(rig.io, *client), "CONNACK code=0");
  gateway_host->ip("link del wpan0");
  ASSERT_TRUE(test::eventually(rig.io, [&] { return !rig.core.links.back().is_up; }));
  connect("wpan0");
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.core.links.back().is_up; }));
  client.reset();
  client = robot(rig.io, "wpan0", "fd00:db8::2", port);
  client->send_to(boost::asio::buffer(encode(Pingreq{"r1"})), gateway);
  EXPECT_EQ(receive(rig.io, *client), "PINGRESP");
}

}  // namespace
}  // namespace slamgw::mqttsn
