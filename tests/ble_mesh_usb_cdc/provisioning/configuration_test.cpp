// SPDX-License-Identifier: Apache-2.0
// The configuration of nodes, as bytes and as a conversation that loses messages.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_configuration.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

/// Returns the octets of this request.
Bytes request(const ble::Exchange& exchange, const auto&... params) {
  return config_step("", exchange, params...).request;
}

TEST(ConfigMessages, EqualThoseOfNordicsHostScript) {
  constexpr std::uint16_t element = 0x0100;
  constexpr std::uint16_t group = 0xc004;
  const Bytes vendor_model = encode_model_id(sensor_update_client);
  const Bytes sig_model = encode_model_id({{}, 0x1000});
  EXPECT_EQ(request(composition_data_get, std::uint8_t{0}), hex("80 08 00"));
  Key key;
  key.fill(0x5a);
  EXPECT_EQ(request(appkey_add, key_indexes_0, key), hex("00 00 00 00") + Bytes(16, 0x5a));
  EXPECT_EQ(request(model_app_bind, element, key_index_0, vendor_model),
            hex("80 3d 00 01 00 00 59 00 06 00"));
  EXPECT_EQ(request(model_app_bind, element, key_index_0, sig_model),
            hex("80 3d 00 01 00 00 00 10"));
  EXPECT_EQ(request(model_subscription_add, element, group, vendor_model),
            hex("80 1b 00 01 04 c0 59 00 06 00"));
  EXPECT_EQ(request(model_subscription_delete, element, group, sig_model),
            hex("80 1c 00 01 04 c0 00 10"));
  EXPECT_EQ(request(sig_model_subscription_get, element, sig_model), hex("80 29 00 01 00 10"));
  EXPECT_EQ(request(vendor_model_subscription_get, element, vendor_model),
            hex("80 2b 00 01 59 00 06 00"));
  EXPECT_EQ(request(node_reset), hex("80 49"));
}

TEST(ConfigMessages, PublishLikeNordicsHostScriptAndNeverWithATtlThatStopsNordicsRobots) {
  for (const int ttl : {4, 127, 128, 200, 254, 255}) {
    Settings settings;
    settings.ttl = static_cast<std::uint8_t>(ttl);
    ProvisioningRig rig(settings);
    rig.add(1);
    rig.start();
    rig.pass(20s);
    const std::string set =
        fmt::format("03000101000000{:02x}000059000600", std::min(ttl, int{max_publish_ttl}));
    EXPECT_EQ(std::ranges::count(rig.sent_to(0x0100), set), 1) << ttl;
  }
}

/// Recorded from Nordic's configuration server, release 3.1.0; parameters, after the opcode.
TEST(ConfigMessages, ReadListsOfSubscriptions) {
  const ModelId vendor{std::uint16_t{0x0059}, 0x0005};
  using Addresses = std::vector<std::uint16_t>;
  EXPECT_EQ(decode_subscription_list(hex("00 00 01 59 00 05 00 02 c0 03 c0"), vendor),
            (Addresses{0xc002, 0xc003}));
  EXPECT_EQ(decode_subscription_list(hex("00 00 01 59 00 05 00 04 c0 85 89"), vendor),
            (Addresses{0xc004, 0x8985}));
  EXPECT_EQ(decode_subscription_list(hex("00 00 01 59 00 05 00"), vendor), Addresses{});
  EXPECT_EQ(decode_subscription_list(hex("00 00 01 00 10 02 c0"), {{}, 0x1000}), Addresses{0xc002});
  EXPECT_EQ(decode_subscription_list(hex("08 00 01 02 00"), {{}, 0x0002}), Addresses{});
  EXPECT_EQ(decode_subscription_list(hex("00 00 01 00 10 02 c0 03"), {{}, 0x1000}),
            Addresses{0xc002});
  EXPECT_EQ(decode_subscription_list(hex("00"), vendor), Addresses{});
}

TEST(ConfigMessages, ReadCompositionDataAndRejectDamages) {
  const Bytes whole = hex("00 59 00 01 00 01 00 28 00 03 00 00 00 01 01 00 10 59 00 06 00") +
                      hex("00 00 00 01 59 00 09 00");
  const auto composition = decode_composition(whole);
  ASSERT_TRUE(composition.has_value());
  EXPECT_EQ(composition->company, 0x0059);
  ASSERT_EQ(composition->elements.size(), 2u);
  EXPECT_EQ(composition->elements[0], (std::vector<ModelId>{{{}, 0x1000}, sensor_update_client}));
  EXPECT_EQ(composition->elements[1], (std::vector<ModelId>{{std::uint16_t{0x0059}, 0x0009}}));
  constexpr std::size_t first_element = 21;  // cut there it is a device with one element
  for (std::size_t size = 0; size < whole.size(); ++size)
    EXPECT_EQ(decode_composition(ByteView(whole).first(size)).has_value(), size == first_element);
  EXPECT_FALSE(decode_composition(hex("01 59 00")).has_value()) << "another page";
}

/// The octet before the model is the number of repeats. BlueZ 5.66 takes 0 for
/// "unlimited"; Nordic's stack sends each repeat as a message of its own.
TEST(Configuration, RepeatsPublicationsOnlyWhereZeroMeansUnlimited) {
  const auto requests_of = [](std::string_view composition) {
    ProvisioningRig rig;
    rig.add(1).composition = hex(composition);
    rig.start();
    EXPECT_TRUE(rig.all_configured(20s));
    return rig.board.devices.devices[0].requests;
  };
  const auto has = [](const std::vector<std::string>& requests, const char* request) {
    return std::ranges::find(requests, request) != requests.end();
  };
  const char* const once = "0300010100000004000059000600";
  const char* const repeated = "0300010100000004000159000600";
  EXPECT_TRUE(
      has(requests_of("00 59 00 01 00 01 00 28 00 00 00 00 00 01 01 02 00 59 00 06 00"), once))
      << "Nordic's robots have a health server";
  EXPECT_TRUE(
      has(requests_of("00 59 00 01 00 01 00 64 00 00 00 00 00 01 01 00 00 59 00 06 00"), repeated))
      << "a robot on BlueZ has none";
  EXPECT_TRUE(
      has(requests_of("00 f1 05 01 00 01 00 64 00 00 00 00 00 01 01 02 00 59 00 06 00"), repeated))
      << "this device is not Nordic's";
}

TEST(Configuration, SendsAllMessagesThatRobotNeeds) {
  ProvisioningRig rig;
  const std::string app_key = to_hex(Bytes(16, 0x22));
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  EXPECT_EQ(rig.board.devices.devices[0].requests,
            (std::vector<std::string>{
                "800800", "00000000" + app_key, "803d000100000200",
                "03000101000000044a000200",  // health, each 10 s
                "803d000100000010", "802900010010", "801b000102c00010", "801b000103c00010",
                "801b000104c00010",
                "803d000100000110",                                      // on/off server and client
                "803d0001000059000400", "0300010100000004000059000400",  // min_com client
                "803d0001000059000600", "0300010100000004000059000600",  // sensor_update client
                "803d0001000059000900", "802b000159000900", "801b000102c059000900",
                "801b000103c059000900", "801b000104c059000900"}));  // pos_cmd server
}

TEST(Configuration, AsksAgainWhenAnAnswerIsLost) {
  for (const char* request : {"800800", "00", "803d", "03", "8029", "802b", "801b"}) {
    ProvisioningRig rig;
    rig.add(1).deaf_to = {request};
    rig.start();
    rig.pass(5s);
    rig.board.devices.devices[0].deaf_to.clear();
    EXPECT_TRUE(rig.all_configured(10s)) << request;
    EXPECT_FALSE(rig.has_notice("not configured")) << request;
  }
}

TEST(Configuration, RetriesRobotThatWasConfiguredInPart) {
  ProvisioningRig rig;
  rig.add(1).deaf_to = {"803d"};
  rig.start();
  rig.pass(25s);
  EXPECT_TRUE(
      rig.has_notice("ble-0100 is in the mesh but not configured: no answer to the key "
                     "binding of model 0x0002 in 20 s"));
  EXPECT_EQ(rig.stored.back().nodes.at(0).state, NodeState::provisioned);
  EXPECT_TRUE(rig.board.devices.device_keys.empty());
  rig.board.devices.devices[0].deaf_to.clear();
  EXPECT_TRUE(rig.all_configured(10s));
}

/// Such a robot would occupy one of the few conversations for hours.
TEST(Configuration, EndsWhenTheRobotAnswersEachRequestLate) {
  ProvisioningRig rig;
  FakeDevice& device = rig.add(1);
  device.composition = hex("00 59 00 01 00 01 00 28 00 00 00 00 00 64 00");
  for (int model = 0; model < 100; ++model) device.composition = device.composition + hex("00 10");
  rig.start();
  while (device.requests.empty()) rig.pass(100ms);
  for (const TimePoint end = rig.now + 11min; rig.now < end;) {
    device.deaf_to = {""};
    rig.run_for(14s);
    device.deaf_to.clear();
    for (const std::size_t before = device.requests.size(); device.requests.size() == before;)
      rig.run_for(1ms);
  }
  EXPECT_TRUE(rig.has_notice("not configured: it did not end in 10 min"));
}

TEST(Configuration, ContinuesAtOnceWhenRobotIsHeardAgain) {
  ProvisioningRig rig;
  rig.add(1).deaf_to = {"8008"};
  rig.start();
  rig.pass(120s);  // several failures: the next attempt is late
  rig.board.devices.devices[0].deaf_to.clear();
  rig.hear(0x0100, "04 00 59 00");
  EXPECT_TRUE(rig.all_configured(3s));
}

TEST(Configuration, ContinuesAfterRestart) {
  ProvisioningRig first;
  first.add(1).deaf_to = {"80"};
  first.start();
  first.pass(5s);
  ProvisioningRig second({}, first.stored.back());
  second.board = first.board;
  second.board.devices.devices[0].deaf_to.clear();
  ASSERT_FALSE(second.board.devices.device_keys.empty()) << "left by the first daemon";
  second.start();
  EXPECT_TRUE(second.all_configured(10s));
}

TEST(Configuration, ReportsRefusedRequest) {
  ProvisioningRig rig;
  rig.add(1).refuses = {{"801b", 0x08}};
  rig.start();
  rig.pass(4s);
  EXPECT_TRUE(
      rig.has_notice("the subscription to 0xc002 of model 0x1000 was refused: not a "
                     "subscribe model (0x08)"));
  EXPECT_FALSE(rig.has_notice("is configured"));
  EXPECT_EQ(rig.board.devices.devices[0].requests.size(), 13u) << "the remaining requests are sent";
}

TEST(Configuration, ReplacesTheGroupsThatARobotHad) {
  for (const bool shares : {false, true}) {
    ProvisioningRig rig;
    FakeDevice& device = rig.add(1);
    device.shares_subscriptions = shares;
    device.deaf_to = {"803d000100000110"};  // comes after the first model that has groups
    rig.start();
    rig.pass(23s);
    ASSERT_TRUE(rig.has_notice("not configured"));
    ASSERT_EQ(device.subscriptions.size(), 1u);
    device.subscriptions.begin()->second.insert(0xc00f);
    device.deaf_to.clear();
    ASSERT_TRUE(rig.all_configured(10s));
    EXPECT_EQ(device.subscriptions.size(), shares ? 1u : 2u);
    for (const auto& [model, groups] : device.subscriptions)
      EXPECT_EQ(groups, (std::set<std::uint16_t>{0xc002, 0xc003, 0xc004})) << model;
  }
}

TEST(Configuration, NeverStopsARobotThatRunsNordicsCode) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(10s));
  const FakeDevice& device = rig.board.devices.devices[0];
  EXPECT_FALSE(device.has_stopped);
  for (const std::string& request : device.requests) {
    EXPECT_FALSE(request.starts_with("801d")) << "Model Subscription Delete All";
    EXPECT_FALSE(request.starts_with("801e")) << "Model Subscription Overwrite";
  }
}

TEST(Configuration, KeepsSubscriptionsToVirtualAddresses) {
  ProvisioningRig rig;
  rig.add(1).subscriptions["00010010"] = {0x8985, 0xc002, 0xc00f};
  rig.board.devices.devices[0].keeps_subscriptions = true;
  rig.start();
  ASSERT_TRUE(rig.all_configured(10s));
  EXPECT_EQ(rig.board.devices.devices[0].subscriptions.at("00010010"),
            (std::set<std::uint16_t>{0x8985, 0xc002, 0xc003, 0xc004}));
}

TEST(Configuration, ReportsRefusedListOfSubscriptions) {
  ProvisioningRig rig;
  rig.add(1).refuses = {{"8029", 0x08}};
  rig.start();
  rig.pass(4s);
  EXPECT_TRUE(
      rig.has_notice("the list of subscriptions of model 0x1000 was refused: not a subscribe "
                     "model (0x08)"));
  EXPECT_FALSE(rig.has_notice("is configured"));
}

Settings without_groups() {
  Settings settings;
  settings.groups.clear();
  return settings;
}

TEST(Configuration, SubscribesToNothingWithoutGroups) {
  ProvisioningRig rig(without_groups());
  rig.add(1);
  rig.start();
  EXPECT_TRUE(rig.all_configured(5s));
  EXPECT_EQ(rig.board.devices.devices[0].requests.back(), "802b000159000900");
}

TEST(Configuration, AcceptsModelsThatCannotSubscribe) {
  ProvisioningRig rig(without_groups());
  rig.add(1).refuses = {{"8029", 0x08}, {"802b", 0x08}};
  rig.start();
  EXPECT_TRUE(rig.all_configured(5s));
}

TEST(Configuration, ReportsRobotThatKeepsItsGroups) {
  ProvisioningRig rig(without_groups());
  FakeDevice& device = rig.add(1);
  device.subscriptions["00010010"] = {0xc00f};
  device.keeps_subscriptions = true;
  device.refuses["801c"] = 0x0e;
  rig.start();
  rig.pass(5s);
  EXPECT_TRUE(
      rig.has_notice("the end of the subscription to 0xc00f of model 0x1000 was refused: "
                     "temporarily"));
}

TEST(Configuration, GivesUpWhenTheRobotHasAnotherKey) {
  ProvisioningRig rig;
  rig.add(1).refuses["00"] = 0x06;
  rig.start();
  rig.pass(4s);
  EXPECT_TRUE(rig.has_notice("the application key was refused: key index already stored"));
  EXPECT_EQ(rig.board.devices.devices[0].requests.size(), 1u);
}

TEST(Configuration, WaitsWhileTheBoardIsStillSending) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.busy_sends = 20;
  rig.start();
  EXPECT_TRUE(rig.all_configured(10s));
}

TEST(Configuration, RemovesUnknownDeviceKeysFromBoard) {
  ProvisioningRig rig;
  rig.add(1);
  for (std::uint16_t handle = 8; handle < 18; ++handle)
    rig.board.devices.device_keys[handle] = {static_cast<std::uint16_t>(0x0100 + handle - 8), {}};
  rig.start();
  EXPECT_TRUE(rig.all_configured(20s));
}

TEST(Configuration, IgnoresAnswersThatAreNotUnderTheDeviceKey) {
  ProvisioningRig rig;
  rig.add(1).deaf_to = {"00"};
  rig.start();
  rig.pass(3s);
  rig.hear(0x0100, "80 03 00 00 00 00");  // under the application key
  rig.pass(3s);
  EXPECT_TRUE(rig.board.devices.devices[0].app_key.empty());
  EXPECT_EQ(rig.board.devices.devices[0].requests.size(), 1u);
}

}  // namespace
}  // namespace slamgw::ble
