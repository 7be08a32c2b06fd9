// SPDX-License-Identifier: Apache-2.0
// The survey of which robots hear which: its requests and its results. It neither stops a robot,
// nor leaves heartbeats on, nor delays more urgent messages.
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr const char* publication_set = "803902c0";  // to the first group
constexpr const char* subscription_set = "803b";

struct SurveyRig : ProvisioningRig {
  explicit SurveyRig(std::size_t robots = 3, const Settings& settings = {})
      : ProvisioningRig(settings) {
    for (std::size_t i = 1; i <= robots; ++i) add(static_cast<std::uint8_t>(i));
    start();
    if (!all_configured(20s * robots)) ADD_FAILURE() << "not all robots have joined";
  }
  FakeDevice& device(std::size_t i) { return board.devices.devices[i]; }

  nlohmann::json measure(bool is_question = false) {
    order(MeasureHearingOrder{is_question});
    return answer();
  }
  /// Returns the result of the survey.
  nlohmann::json result(Duration limit = 600s) {
    const TimePoint end = now + limit;
    while (measure(true)["state"] == "running" && now < end) pass(500ms);
    return answer();
  }
  std::size_t said(std::string_view request) const {
    return static_cast<std::size_t>(std::ranges::count_if(board.sent, [&](const auto& packet) {
      return to_hex(packet.payload).starts_with(request);
    }));
  }
  bool is_quiet() const {
    return std::ranges::all_of(board.devices.devices, [](const FakeDevice& each) {
      return each.heartbeats.publishes_to == 0 && each.heartbeats.source == 0;
    });
  }
};

nlohmann::json row_of(const nlohmann::json& result, const char* source, const char* listener) {
  for (const nlohmann::json& row : result["rows"])
    if (row["source"] == source && row["listener"] == listener) return row;
  return nullptr;
}

TEST(HearingSurvey, ReportsWhichRobotsHearEachOther) {
  SurveyRig rig;
  rig.board.devices.hearing = {{{0x0100, 0x0101}, {5, 1, 2}}, {{0x0102, 0x0100}, {0, 0, 0}}};
  const auto begun = rig.measure();
  EXPECT_EQ(begun["state"], "running") << begun;
  EXPECT_EQ(begun["robots"], 3);
  EXPECT_EQ(begun["measured"], 0);
  EXPECT_NEAR(begun["seconds_left"].get<double>(), 3 * 9.9 + 0.9, 1);
  const TimePoint start = rig.now;
  const auto result = rig.result();
  EXPECT_EQ(result["state"], "done") << result;
  EXPECT_LT(rig.now - start, 32s);
  EXPECT_EQ(result["rows"].size(), 6u);
  EXPECT_EQ(row_of(result, "ble-0101", "ble-0100"),
            nlohmann::json::parse(R"({"source":"ble-0101","listener":"ble-0100","sent":8,"heard":8,
                                      "heard_at_most":8,"min_hops":1,"max_hops":1})"));
  const auto some = row_of(result, "ble-0100", "ble-0101");
  EXPECT_EQ(some["heard"], 4) << "robots report the highest bit only";
  EXPECT_EQ(some["heard_at_most"], 7);
  EXPECT_EQ(some["max_hops"], 2);
  const auto none = row_of(result, "ble-0102", "ble-0100");
  EXPECT_EQ(none["heard_at_most"], 0);
  EXPECT_TRUE(none["min_hops"].is_null());
  EXPECT_TRUE(result["silent"].empty());
  EXPECT_TRUE(rig.is_quiet());
  EXPECT_TRUE(rig.board.devices.device_keys.empty());
}

TEST(HearingSurvey, SendsMessagesInFormatOfSpecification) {
  SurveyRig rig(2);
  const std::size_t before = rig.device(0).requests.size();
  rig.measure();
  rig.result();
  const auto& requests = rig.device(0).requests;
  const std::vector<std::string> asked(requests.begin() + static_cast<std::ptrdiff_t>(before),
                                       requests.end());
  EXPECT_EQ(asked, (std::vector<std::string>{
                       "803902c004010400000000",  // 8, a second apart, TTL 4, no features, key 0
                       "803b010102c009",          // counts the other robot's for 256 s
                       "803a", "803b0000000000",
                       "803900000000000000"
                       "0000"}));
}

TEST(HearingSurvey, HeartbeatsUseTtlOfRobotsMessages) {
  Settings settings;
  settings.groups.clear();
  SurveyRig rig(2, settings);
  NodeConfigOrder config{"ble-0101"};
  config.ttl.emplace(9);
  rig.order(config);
  rig.pass(20s);
  rig.measure();
  EXPECT_EQ(rig.result()["rows"].size(), 2u);
  EXPECT_EQ(rig.said("8039ffff040104"), 1u) << "to all nodes, as robots are in no group";
  EXPECT_EQ(rig.said("8039ffff040109"), 1u);
}

TEST(HearingSurvey, ListsSilentRobotAndSkipsItSoon) {
  SurveyRig rig(4);
  rig.device(1).deaf_to = {"80"};
  rig.measure();
  const TimePoint start = rig.now;
  const auto result = rig.result();
  EXPECT_EQ(result["state"], "done");
  EXPECT_EQ(result["silent"], nlohmann::json::array({"ble-0101"}));
  EXPECT_EQ(result["rows"].size(), 6u) << result;
  EXPECT_LT(rig.now - start, 50s);
}

TEST(HearingSurvey, AsksRobotAboutNextSenderAfterMissingAnswer) {
  SurveyRig rig;
  rig.device(2).lost_answers = {"803a", "803a", "803a", "803a"};
  rig.measure();
  const auto result = rig.result();
  EXPECT_EQ(result["silent"], nlohmann::json::array({"ble-0102"}));
  EXPECT_TRUE(row_of(result, "ble-0100", "ble-0102").is_null());
  EXPECT_EQ(row_of(result, "ble-0101", "ble-0102")["heard"], 8);
}

/// Robots that run Nordic's code up to 3.0 stop at a second request within a second.
TEST(HearingSurvey, RepeatsPublicationSetWhenItsHeartbeatsWouldBeOver) {
  for (const bool is_request_lost : {false, true}) {
    SurveyRig rig;
    auto& losses = is_request_lost ? rig.device(0).lost_requests : rig.device(0).lost_answers;
    losses = {publication_set};
    rig.measure();
    rig.pass(8s);
    EXPECT_EQ(rig.said(publication_set), 1u);
    rig.pass(3s);
    EXPECT_EQ(rig.said(publication_set), 2u);
    const auto result = rig.result();
    EXPECT_EQ(rig.said(publication_set), 4u);
    EXPECT_EQ(result["rows"].size(), 6u) << result;
    EXPECT_EQ(row_of(result, "ble-0100", "ble-0101")["heard"], 8);
    EXPECT_TRUE(result["silent"].empty());
  }
}

TEST(HearingSurvey, DoesNotRepeatPublicationSetWhenAnotherSendIsRefused) {
  SurveyRig rig;
  rig.device(0).lost_answers = {publication_set};
  rig.measure();
  rig.pass(2s);
  ASSERT_EQ(rig.said(publication_set), 1u);
  rig.board.busy_sends = 1;
  rig.command("ble-0100/cmd", hex("01 00 02 00"));
  rig.pass(2s);
  EXPECT_EQ(rig.board.busy_sends, 0);
  EXPECT_EQ(rig.said(publication_set), 1u);
}

TEST(HearingSurvey, GivesUpOnRobotThatDoesNotPublish) {
  SurveyRig rig;
  rig.device(0).deaf_to = {publication_set};
  rig.measure();
  const auto result = rig.result();
  EXPECT_EQ(rig.said(publication_set), 2u + HearingSurvey::max_attempts);
  EXPECT_EQ(result["rows"].size(), 4u) << "the others are measured";
  EXPECT_EQ(result["silent"], nlohmann::json::array({"ble-0100"}));
}

TEST(HearingSurvey, OmitsRowOfRobotThatLostItsSubscription) {
  SurveyRig rig(2);
  rig.device(1).lies = {{"803a", "80 3c 00 00 00 00 00 00 00 00 00"}};
  rig.measure();
  const auto result = rig.result();
  EXPECT_TRUE(row_of(result, "ble-0100", "ble-0101").is_null());
  EXPECT_EQ(result["silent"], nlohmann::json::array({"ble-0101"}));
}

TEST(HearingSurvey, BadAnswersHaveNoEffect) {
  SurveyRig rig(2);
  for (const char* answer : {"80 3c", "80 3c 00 00 01", "80 3c 00 00 01 02 c0 09 ff ff",
                             "80 3c 00 00 01 02 c0 09 ff ff ff", "80 3c 10", "06", ""}) {
    rig.device(1).lies = {{"803a", answer}, {"803902c0", "06 00 02"}};
    rig.measure();
    const auto result = rig.result();
    EXPECT_EQ(result["state"], "done") << answer;
    for (const auto& row : result["rows"]) EXPECT_LE(row["heard_at_most"], 8) << row;
  }
}

TEST(HearingSurvey, LetsCommandsPingsAndConfigurationPass) {
  SurveyRig rig(4);
  rig.measure();
  rig.pass(3s);
  rig.board.sent.clear();
  rig.command("ble-0101/cmd", hex("01 00 02 00"));
  EXPECT_FALSE(rig.sent_to(0x0101).empty());
  rig.order(PingOrder{"ble-0102"});
  rig.pass(1s);
  EXPECT_EQ(rig.answer()["answered"], true);
  NodeConfigOrder config{"ble-0103"};
  config.ttl.emplace(7);
  rig.order(config);
  rig.pass(3s);
  EXPECT_EQ(rig.answer()["ttl"], 7) << rig.answer();
  rig.add(9);
  rig.pass(10s);
  EXPECT_EQ(rig.configured(), 5u) << "a new robot joins";
  EXPECT_EQ(rig.measure(true)["state"], "running");
  EXPECT_EQ(rig.result()["rows"].size(), 12u) << "the new robot joined too late";
}

TEST(HearingSurvey, OmitsRobotThatIsRemovedDuringSurvey) {
  SurveyRig rig;
  rig.measure();
  rig.pass(3s);
  rig.order(RemoveOrder{"ble-0101"});
  rig.pass(3s);
  EXPECT_EQ(rig.answer()["was_reset"], true) << rig.answer();
  const auto result = rig.result();
  EXPECT_EQ(result["state"], "done");
  EXPECT_EQ(row_of(result, "ble-0102", "ble-0100")["heard"], 8);
}

TEST(HearingSurvey, FailsWhenLinkGoesDownAndCanBeginAgain) {
  SurveyRig rig;
  rig.measure();
  rig.pass(3s);
  rig.power_cycle_board();
  auto result = rig.measure(true);
  EXPECT_EQ(result["state"], "failed");
  EXPECT_NE(result["why"].dump().find("link went down"), std::string::npos);
  rig.pass(30s);
  EXPECT_EQ(rig.measure()["state"], "running");
  result = rig.result();
  EXPECT_EQ(result["rows"].size(), 6u);
  EXPECT_TRUE(rig.is_quiet());
}

TEST(HearingSurvey, SecondOrderReportsRunningSurvey) {
  SurveyRig rig(2);
  EXPECT_EQ(rig.measure(true)["state"], "none");
  rig.measure();
  rig.pass(11s);
  EXPECT_EQ(rig.measure()["measured"], 1);
  rig.result();
  EXPECT_EQ(rig.said(publication_set), 2u);
}

TEST(HearingSurvey, IsRefusedWhereItCannotRun) {
  const auto refusal = [](const SurveyRig& rig) { return rig.answer().get<std::string>(); };
  SurveyRig alone(1);
  alone.measure();
  EXPECT_NE(refusal(alone).find("two configured robots"), std::string::npos);
  SurveyRig rig(2);
  rig.device(0).deaf_to = {"8045"};
  rig.order(RefreshKeysOrder{});
  rig.measure();
  EXPECT_NE(refusal(rig).find("keys are being refreshed"), std::string::npos);
  SurveyRig busy(2);
  busy.measure();
  busy.order(RefreshKeysOrder{});
  EXPECT_NE(refusal(busy).find("--measure` is running"), std::string::npos);
  SurveyRig crowd(36);
  crowd.measure();
  EXPECT_EQ(crowd.answer()["state"], "running") << crowd.answer();
  SurveyRig too_many(37);
  too_many.measure();
  EXPECT_NE(refusal(too_many).find("37 senders in a list of 40"), std::string::npos);
  EXPECT_EQ(too_many.said(subscription_set), 0u);
}

}  // namespace
}  // namespace slamgw::ble
