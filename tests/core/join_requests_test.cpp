// SPDX-License-Identifier: Apache-2.0
// Permit-join over the broker, without a broker and without a mesh.
#include "daemon/core/join_requests.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <vector>

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

/// Replaces the application: answers like the mesh, and records published responses.
struct JoinRig {
  JoinRequests requests;
  Now now{TimePoint(1h), {}};
  std::vector<OrderJoining> ordered;
  std::vector<json> published;
  std::vector<std::string> warnings;
  std::string refusal;  ///< of the mesh
  int seconds_left = 0;
  int under_way = 0;
  std::uint64_t last = 7;  ///< an earlier permit had events
  std::uint64_t asked_after = 0;

  void ask(const std::string& payload, bool is_retained = false) {
    BrokerMessage message{"ours", to_bytes(payload), Qos::at_least_once, is_retained};
    message.sender = sender_at_broker("ada");
    requests.on_request(message, now);
    drain();
  }
  void pass(std::chrono::seconds time) {
    for (const TimePoint end = now.mono + time; now.mono < end; now.mono += 1s) {
      if (requests.deadline() && now.mono >= *requests.deadline()) requests.on_deadline(now);
      drain();
    }
  }
  std::string news() const {
    json document{{"seconds_left", seconds_left}, {"under_way", under_way}, {"last", last}};
    document["events"] = json::array();
    for (std::uint64_t n = asked_after + 1; n <= last; ++n)
      document["events"].push_back({{"number", n}});
    return document.dump();
  }
  void perform(const OrderJoining& order) {
    ordered.push_back(order);
    if (refusal.empty()) seconds_left = static_cast<int>(order.order.time.count());
    requests.on_ordered(refusal.empty() ? OrderAnswer{news(), {}} : OrderAnswer{{}, refusal}, now);
  }
  void perform(const AskJoining& ask) {
    asked_after = ask.order.after;
    requests.on_news({news(), {}}, now);
  }
  void perform(const PublishJoining& action) { published.push_back(json::parse(action.document)); }
  void perform(const Notice& notice) { warnings.push_back(notice.text); }
  void drain() {
    while (auto action = requests.next_action())
      std::visit([this](const auto& what) { perform(what); }, *action);
  }
  std::uint64_t count(std::size_t which) const {
    Counters counters;
    requests.add_to(counters);
    return counters.at(which).value;
  }
};

TEST(JoinRequests, AreOrderedForTheirSenderAndAnswered) {
  JoinRig rig;
  rig.ask(R"({"seconds": 90, "name": "lego-1"})");
  ASSERT_EQ(rig.ordered.size(), 1U);
  EXPECT_EQ(rig.ordered[0].who, "broker: ada");
  EXPECT_EQ(rig.ordered[0].order.time, 90s);
  EXPECT_EQ(rig.ordered[0].order.robot, "lego-1");
  ASSERT_EQ(rig.published.size(), 1U);
  EXPECT_EQ(rig.published[0]["seconds_left"], 90);
  EXPECT_EQ(rig.published[0]["events"], json::array());
  EXPECT_EQ(rig.count(0), 1U);
}

TEST(JoinRequests, EachResponseHasAllEventsSinceThePermit) {
  JoinRig rig;
  rig.ask(R"({"seconds": 60})");
  rig.last = 8;
  rig.pass(2s);
  rig.last = 9;
  rig.pass(2s);
  ASSERT_EQ(rig.published.size(), 3U);
  EXPECT_EQ(rig.published[1]["events"].size(), 1U);
  EXPECT_EQ(rig.published[2]["events"].size(), 2U);
  rig.last = 7 + 2 * JoinRequests::max_events;
  rig.pass(2s);
  EXPECT_EQ(rig.published.back()["events"].size(), JoinRequests::max_events);
  EXPECT_EQ(rig.published.back()["events"].back()["number"], rig.last);
}

TEST(JoinRequests, ResponseIsPublishedAgainUntilJoiningIsOver) {
  JoinRig rig;
  rig.ask(R"({"seconds": 60})");
  rig.pass(25s);
  EXPECT_EQ(rig.published.size(), 3U);
  rig.seconds_left = 0;
  rig.under_way = 1;
  rig.pass(15s);
  EXPECT_EQ(rig.published.back()["under_way"], 1);
  rig.under_way = 0;
  rig.pass(2s);
  EXPECT_EQ(rig.published.back()["under_way"], 0);
  EXPECT_FALSE(rig.requests.deadline());
}

TEST(JoinRequests, ZeroSecondsEndJoining) {
  JoinRig rig;
  rig.ask(R"({"seconds": 60})");
  rig.last = 8;
  rig.pass(2s);
  rig.ask(R"({"seconds": 0})");
  EXPECT_EQ(rig.published.back()["seconds_left"], 0);
  EXPECT_EQ(rig.published.back()["events"].size(), 1U);
  EXPECT_FALSE(rig.requests.deadline());
}

TEST(JoinRequests, RefusalOfTheMeshIsAnsweredWithItsReason) {
  JoinRig rig;
  rig.refusal = "the BLE link is down: no board";
  rig.ask(R"({"seconds": 60})");
  EXPECT_EQ(rig.published, std::vector<json>({{{"error", "the BLE link is down: no board"}}}));
  EXPECT_FALSE(rig.requests.deadline());
  EXPECT_TRUE(rig.warnings.empty());  // the audit trail has it
}

TEST(JoinRequests, AreAnsweredWithAnErrorAndCountedWhenMalformed) {
  JoinRig rig;
  for (const std::string& payload :
       {std::string(), std::string("60"), std::string("{"), std::string(R"({"time": 60})"),
        std::string(R"({"seconds": -1})"), std::string(R"({"seconds": "60"})"),
        std::string(R"({"seconds": 86401})"), std::string(R"({"seconds": 1.5})"),
        std::string(R"({"seconds": 60, "name": "a/b"})"),
        std::string(R"({"seconds": 60, "name": 7})"),
        std::string(R"({"seconds": 60, "Name": "r"})"),
        std::string(R"({"seconds": 60, "name": ""})"),
        R"({"seconds": 60, "x": ")" + std::string(JoinRequests::max_payload, 'x') + "\"}"}) {
    rig.published.clear();
    rig.ask(payload);
    ASSERT_EQ(rig.published.size(), 1U) << payload;
    EXPECT_EQ(rig.published[0]["error"].get<std::string>().rfind("a request must be ", 0), 0U);
    rig.now.mono += JoinRequests::shortest_pause;
  }
  EXPECT_TRUE(rig.ordered.empty());
  EXPECT_EQ(rig.count(1), 13U);
  EXPECT_EQ(rig.warnings.size(), 2U);  // in 12 s
}

TEST(JoinRequests, AreRefusedWhenRetained) {
  JoinRig rig;
  rig.ask(R"({"seconds": 60})", true);
  EXPECT_TRUE(rig.ordered.empty());
  EXPECT_EQ(rig.count(1), 1U);
  EXPECT_NE(rig.published.at(0)["error"].get<std::string>().find("retained"), std::string::npos);
}

TEST(JoinRequests, FloodMakesOneOrderASecondAndOneRefusal) {
  JoinRig rig;
  for (int i = 0; i < 1000; ++i) rig.ask(R"({"seconds": 60})");
  EXPECT_EQ(rig.ordered.size(), 1U);
  EXPECT_EQ(rig.published.size(), 2U);  // to the first, and to the first that came too soon
  EXPECT_EQ(rig.warnings.size(), 1U);
  EXPECT_EQ(rig.count(1), 999U);
  rig.now.mono += JoinRequests::shortest_pause;
  rig.ask(R"({"seconds": 0})");
  EXPECT_EQ(rig.ordered.size(), 2U);
}

}  // namespace
}  // namespace slamgw
