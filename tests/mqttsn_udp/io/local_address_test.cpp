// SPDX-License-Identifier: Apache-2.0
// Source addresses of the gateway's messages, also after its interface was recreated under another
// index. The clients' sockets are connected, so the kernel drops messages from other addresses.
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/io/thread_network.hpp"
#include "tests/support/memory_session_store.hpp"

namespace slamgw::mqttsn {
namespace {

using boost::asio::ip::make_address;
using boost::asio::ip::udp;

const std::string cmd_topic = "ntnu-slam/server/r1/cmd";

/// The parameter is `mqttsn.interface`.
class LocalAddressOf : public ThreadNetwork, public testing::WithParamInterface<std::string> {
 protected:
  UdpRig make_rig() { return UdpRig::as_is(settings(GetParam()), &store); }

  void expect(UdpRig& rig, udp::socket& client, const Packet& packet, const std::string& answer) {
    client.send(boost::asio::buffer(encode(packet)));
    ASSERT_EQ(receive(rig.io, client), answer);
  }

  /// Connects robot r1 from `own` and subscribes to its commands.
  udp::socket make_client(UdpRig& rig, const std::string& asked = eid,
                          const std::string& own = "fd00:db8::2") {
    udp::socket client = robot(io, "wpan0", own);
    client.connect({make_address(asked), port});
    expect(rig, client, Connect{false, true, 1, 60, "r1"}, "CONNACK code=0");
    Subscribe subscribe;
    subscribe.msg_id = 1;
    subscribe.topic_name = cmd_topic;
    expect(rig, client, subscribe, "SUBACK qos=0 id=" + id + " msg=1 code=0");
    return client;
  }

  /// Recreates the interface, and waits until the gateway has noticed it.
  void remake_before(UdpRig& rig) {
    remake("wpan0");
    if (GetParam() != "wpan0") return;
    const std::size_t before = rig.core.links.size();
    ASSERT_TRUE(test::eventually(
        rig.io, [&] { return rig.core.links.size() > before && rig.core.links.back().is_up; }));
  }

  void command(UdpRig& rig) {
    rig.adapter.on_broker_message({"r1", {cmd_topic, to_bytes("y"), {}, {}}, CommandId{1}});
  }

  const std::string id = std::to_string(topic_id_of(cmd_topic));
  const std::string delivered = "PUBLISH dup=0 qos=0 retain=0 normal id=" + id + " msg=0 data=79";
  boost::asio::io_context io;  // runs the clients' sockets
  test::MemorySessionStore store;
};

TEST_P(LocalAddressOf, R17_KeepsAClientWhenTheInterfaceIsRecreated) {
  UdpRig rig = make_rig();
  udp::socket client = make_client(rig);
  remake_before(rig);
  command(rig);
  EXPECT_EQ(receive(rig.io, client), delivered) << "before the client sends again";
  expect(rig, client, Pingreq{}, "PINGRESP");
}

TEST_P(LocalAddressOf, R17_KeepsASleeperWhenTheInterfaceIsRecreated) {
  UdpRig rig = make_rig();
  udp::socket client = make_client(rig);
  expect(rig, client, Disconnect{100}, "DISCONNECT plain");
  remake_before(rig);
  command(rig);
  expect(rig, client, Pingreq{"r1"}, delivered);
  EXPECT_EQ(receive(rig.io, client), "PINGRESP");
}

TEST_P(LocalAddressOf, R17_KeepsARestoredClientWhenTheInterfaceIsRecreated) {
  std::optional<udp::socket> client;
  {
    UdpRig before = make_rig();
    client = make_client(before);
  }
  remake("wpan0");
  UdpRig after = make_rig();
  command(after);
  EXPECT_EQ(receive(after.io, *client), delivered);
  expect(after, *client, Pingreq{}, "PINGRESP");
}

INSTANTIATE_TEST_SUITE_P(Gateway, LocalAddressOf, testing::Values("*", "auto", "wpan0"),
                         [](const auto& interface) {
                           if (interface.param == "auto") return "OnThreadsInterfaces";
                           return interface.param == "*" ? "OnAllInterfaces" : "OnOneInterface";
                         });

class LocalAddressOfOne : public LocalAddressOf {};

TEST_P(LocalAddressOfOne, R17_KeepsALinkLocalClientWhenTheInterfaceIsRecreated) {
  UdpRig rig = make_rig();
  udp::socket client = make_client(rig, "fe80::1%wpan0", "fe80::2%wpan0");
  remake_before(rig);
  command(rig);
  EXPECT_EQ(receive(rig.io, client), delivered);
  expect(rig, client, Pingreq{}, "PINGRESP");
}

INSTANTIATE_TEST_SUITE_P(Gateway, LocalAddressOfOne, testing::Values("wpan0"));

class LocalAddressPerMessage : public LocalAddressOf {};

TEST_P(LocalAddressPerMessage, R17_IsTheDestinationOfTheLastMessage) {
  UdpRig rig = make_rig();
  udp::socket client = robot(io, "wpan0", "fd00:db8::2");
  const auto is_answered_by = [&](const std::string& address, const Packet& packet,
                                  const std::string& answer) {
    client.send_to(boost::asio::buffer(encode(packet)), {make_address(address), port});
    udp::endpoint from;
    EXPECT_EQ(receive(rig.io, client, &from), answer);
    EXPECT_EQ(from.address(), make_address(address)) << answer;
  };
  const Connect connect{true, true, 1, 60, "r1"};
  is_answered_by(rloc, connect, "WILLTOPICREQ");
  is_answered_by(eid, WillTopic{{}, false, "ntnu-slam/robot/r1/x"}, "WILLMSGREQ");
  is_answered_by(aloc, WillMsg{}, "CONNACK code=0");
  const Connect without_will{false, true, 1, 60, "r1"};
  is_answered_by(rloc, without_will, "CONNACK code=0");
  is_answered_by(eid, without_will, "CONNACK code=0");
  is_answered_by(aloc, Pingreq{}, "PINGRESP");
  is_answered_by(eid, Pingreq{"r1"}, "PINGRESP");
  is_answered_by(rloc, Disconnect{100}, "DISCONNECT plain");
  is_answered_by(eid, Pingreq{"r1"}, "PINGRESP");
}

INSTANTIATE_TEST_SUITE_P(Gateway, LocalAddressPerMessage, testing::Values("wpan0"));

}  // namespace
}  // namespace slamgw::mqttsn
