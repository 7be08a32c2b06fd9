// SPDX-License-Identifier: Apache-2.0
// One long conversation, run again with each of its datagrams lost in turn (and once more with each
// repeated). Both sides must end in the same state.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

const std::string up = "ntnu-slam/robot/r1/n";
const std::string down = "ntnu-slam/server/r1/n";

enum class Fault { lose, repeat };

/// A client that repeats each request until it is answered, and the messages that it got.
class Conversation {
 public:
  Conversation(Fault fault, std::size_t at) : fault_(fault), at_(at) {}

  void run() {
    ask(Connect{true, false, 1, 600, "r1"}, "WILLTOPICREQ");
    ask(WillTopic{WireQos::one, false, "ntnu-slam/robot/r1/gone"}, "WILLMSGREQ");
    ask(WillMsg{to_bytes("bye")}, "CONNACK code=0");
    ask(Register{0, 1, up}, "REGACK id=1 msg=1 code=0");
    ask(by_name(down, 2), "SUBACK");
    rig_.broker(down, "a", 1);
    ask(Publish{false, WireQos::one, false, TopicIdType::normal, 1, 3, to_bytes("one")}, "PUBACK");
    rig_.broker(down, "b", 2);
    ask(Publish{false, WireQos::two, false, TopicIdType::normal, 1, 4, to_bytes("two")},
        "PUBREC msg=4");
    ask(Pubrel{4}, "PUBCOMP msg=4");
    ask(WillMsgUpd{to_bytes("gone")}, "WILLMSGRESP");
    ask(Disconnect{100}, "DISCONNECT");
    rig_.broker(down, "c", 1);
    rig_.broker(down, "d", 2);
    ask(Pingreq{"r1"}, "PINGRESP");
    ask(Connect{false, false, 1, 600, "r1"}, "CONNACK code=0");
    ask(Pingreq{}, "PINGRESP");
    rig_.pass_s(120);  // the gateway's own repetitions
    listen();
    rig_.pass_s(2000);  // then the silent client is lost
  }

  /// Returns an empty string if the final state is as expected.
  std::string complaint() const {
    if (!unanswered_.empty()) return "no answer to " + unanswered_;
    std::string payloads;
    for (const Report& report : rig_.reports) payloads += text(report.payload) + " ";
    if (payloads != "one two gone ") return "went up: " + payloads;
    std::vector<std::string> once = got_;
    std::sort(once.begin(), once.end());
    once.erase(std::unique(once.begin(), once.end()), once.end());
    if (once != std::vector<std::string>{"61", "62", "63", "64"})
      return "came down: " + std::to_string(once.size()) + " of 4";
    for (const char* exactly_once : {"62", "64"}) {
      if (std::count(got_.begin(), got_.end(), exactly_once) != 1)
        return std::string("not once: ") + exactly_once;
    }
    return {};
  }
  std::size_t datagrams() const { return count_; }

 private:
  static Subscribe by_name(const std::string& filter, std::uint16_t msg_id) {
    Subscribe subscribe;
    subscribe.qos = WireQos::two;
    subscribe.msg_id = msg_id;
    subscribe.topic_name = filter;
    return subscribe;
  }
  static std::string text(ByteView bytes) { return {bytes.begin(), bytes.end()}; }

  void ask(const Packet& request, const std::string& answer) {
    for (int attempt = 0; attempt < 4; ++attempt) {
      send(request);
      if (listen(answer)) return;
      rig_.pass_s(8);
      if (listen(answer)) return;
    }
    unanswered_ = answer;
  }
  void send(const Packet& packet) {
    for (unsigned copies = copies_of_next(); copies > 0; --copies) rig_.send(1, packet);
    for (; acknowledged_ < rig_.reports.size(); ++acknowledged_)
      rig_.receipt(rig_.reports[acknowledged_].receipt.id);
  }
  /// Reads all messages to the client. Returns true if `answer` is among them.
  bool listen(const std::string& answer = "nothing") {
    bool is_answered = false;
    for (auto lines = rig_.sent_to(1); !lines.empty(); lines = rig_.sent_to(1)) {
      for (const std::string& line : lines) {
        for (unsigned copies = copies_of_next(); copies > 0; --copies) {
          is_answered |= line.starts_with(answer);
          react(line);
        }
      }
    }
    return is_answered;
  }
  unsigned copies_of_next() {
    if (count_++ != at_) return 1;
    return fault_ == Fault::lose ? 0 : 2;
  }
  void react(const std::string& line) {
    unsigned qos = 0;
    unsigned id = 0;
    unsigned msg_id = 0;
    char data[32] = "";
    if (std::sscanf(line.c_str(), "PUBLISH dup=%*u qos=%u retain=0 normal id=%u msg=%u data=%31s",
                    &qos, &id, &msg_id, data) == 4) {
      const auto msg = static_cast<std::uint16_t>(msg_id);
      const bool is_known = qos == 2 && std::exchange(open_qos2_[msg], true);
      if (!is_known) got_.emplace_back(data);
      if (qos == 1) send(Puback{static_cast<std::uint16_t>(id), msg, ReturnCode::accepted});
      if (qos == 2) send(Pubrec{msg});
    } else if (std::sscanf(line.c_str(), "PUBREL msg=%u", &msg_id) == 1) {
      open_qos2_[static_cast<std::uint16_t>(msg_id)] = false;
      send(Pubcomp{static_cast<std::uint16_t>(msg_id)});
    } else if (std::sscanf(line.c_str(), "REGISTER id=%u msg=%u", &id, &msg_id) == 2) {
      send(Regack{static_cast<std::uint16_t>(id), static_cast<std::uint16_t>(msg_id),
                  ReturnCode::accepted});
    }
  }

  SnRig rig_;
  const Fault fault_;
  const std::size_t at_;
  std::size_t count_ = 0;
  std::size_t acknowledged_ = 0;
  std::string unanswered_;
  std::vector<std::string> got_;
  std::map<std::uint16_t, bool> open_qos2_;
};

std::size_t datagrams_without_fault() {
  Conversation conversation(Fault::lose, SIZE_MAX);
  conversation.run();
  EXPECT_EQ(conversation.complaint(), "");
  return conversation.datagrams();
}

void run_with_each(Fault fault) {
  const std::size_t count = datagrams_without_fault();
  ASSERT_GT(count, 30U);
  for (std::size_t at = 0; at < count; ++at) {
    Conversation conversation(fault, at);
    conversation.run();
    EXPECT_EQ(conversation.complaint(), "") << "datagram " << at;
  }
}

TEST(Conversation, EndsTheSameWithAnyDatagramLost) { run_with_each(Fault::lose); }

TEST(Conversation, EndsTheSameWithAnyDatagramRepeated) { run_with_each(Fault::repeat); }

}  // namespace
}  // namespace slamgw::mqttsn
