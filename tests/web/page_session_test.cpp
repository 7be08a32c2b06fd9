// SPDX-License-Identifier: Apache-2.0
#include "web/server/page_session.hpp"

#include <gtest/gtest.h>

namespace slamgw::web::test {
namespace {

using namespace std::chrono_literals;

class WebSession : public testing::Test {
 protected:
  Topics topics{"ntnu-slam"};
  Tokens tokens = std::get<Tokens>(Tokens::parse("0123456789abcdef\n"));
  TokenGuesses guesses;
  PageSession session = of("192.0.2.1");
  PageSession::TimePoint now{};

  PageSession of(std::string client) { return {topics, tokens, guesses, {std::move(client)}}; }
  PageSession::Reaction say(std::string_view text) { return session.on_text(text, now); }
  static constexpr const char* right = R"({"topic":"$web/token","payload":"0123456789abcdef"})";
  static constexpr const char* wrong = R"({"topic":"$web/token","payload":"guess"})";
  static constexpr const char* stop = R"({"topic":"ntnu-slam/server/r/run","payload":"stop"})";
};

TEST_F(WebSession, SendsNoCommandBeforeToken) {
  EXPECT_FALSE(say(stop).publish);
  EXPECT_NE(say(stop).reply.find("$web/refused"), std::string::npos);
  EXPECT_NE(say(right).reply.find("\"accepted\":true"), std::string::npos);
  const auto reaction = say(stop);
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->topic, "ntnu-slam/server/r/run");
  EXPECT_EQ(reaction.publish->payload, "stop");
  EXPECT_EQ(reaction.publish->sender, "operator, page at 192.0.2.1");
}

TEST_F(WebSession, DecodesHexPayloads) {
  say(right);
  const auto reaction =
      say(R"({"topic":"ntnu-slam/server/r/cmd","payload":"0a00ecff","encoding":"hex"})");
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->payload, std::string("\x0a\0\xec\xff", 4));
}

TEST_F(WebSession, PermitsJoiningWithTokenOnly) {
  constexpr const char* open =
      R"({"topic":"ntnu-slam/gateway/pi/request/permit_join","payload":"{\"seconds\":300}"})";
  EXPECT_FALSE(say(open).publish);
  say(right);
  const auto reaction = say(open);
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->payload, R"({"seconds":300})");
  EXPECT_EQ(reaction.publish->sender, "operator, page at 192.0.2.1");
}

TEST_F(WebSession, PublishesNothingButCommands) {
  say(right);
  for (const char* topic : {"ntnu-slam/robot/r/update", "ntnu-slam/gateway/g/state", "x",
                            "ntnu-slam/server/r", "ntnu-slam/server/r/+", "$SYS/x"})
    EXPECT_FALSE(say(R"({"payload":"1","topic":")" + std::string(topic) + "\"}").publish) << topic;
}

TEST_F(WebSession, RefusesInvalidMessagesAndGoesOn) {
  say(right);
  for (const std::string text :
       {"", "{", "[]", "null", R"({"topic":1,"payload":2})", R"({"topic":"a"})",
        R"({"topic":"ntnu-slam/server/r/cmd","payload":"0a0","encoding":"hex"})",
        R"({"topic":"ntnu-slam/server/r/cmd","payload":"zz","encoding":"hex"})",
        R"({"topic":"ntnu-slam/server/r/cmd","payload":"x","encoding":"base64"})"}) {
    EXPECT_FALSE(say(text).publish) << text;
    EXPECT_NE(say(text).reply.find("$web/refused"), std::string::npos) << text;
  }
  EXPECT_FALSE(say(std::string(max_page_message + 1, '[')).publish);
  EXPECT_FALSE(say(R"({"topic":"ntnu-slam/server/r/x","payload":")" +
                   std::string(max_command_payload + 1, 'a') + "\"}")
                   .publish);
  EXPECT_TRUE(say(stop).publish);
}

TEST_F(WebSession, EndsAfterThreeWrongTokens) {
  EXPECT_FALSE(say(wrong).ends);
  EXPECT_FALSE(say(wrong).ends);
  EXPECT_TRUE(say(wrong).ends);
  EXPECT_FALSE(say(stop).publish);
}

TEST_F(WebSession, WrongTokenRevokesRight) {
  say(right);
  say(R"({"topic":"$web/token","payload":""})");
  EXPECT_FALSE(say(stop).publish);
}

TEST_F(WebSession, AcceptsNoTokenWhenNoneIsSet) {
  const Tokens none;
  PageSession watching(topics, none, guesses, {"192.0.2.1"});
  watching.on_text(R"({"topic":"$web/token","payload":""})", now);
  EXPECT_EQ(guesses.total(), 0u) << "there is nothing to guess";
  EXPECT_FALSE(watching.on_text(stop, now).publish);
}

class WebRoles : public WebSession {
 protected:
  void SetUp() override {
    tokens = std::get<Tokens>(
        Tokens::parse("ada operator 0123456789abcdef\nbob viewer fedcba9876543210\n"));
  }
  static constexpr const char* of_bob = R"({"topic":"$web/token","payload":"fedcba9876543210"})";
};

TEST_F(WebRoles, ViewerMayWatchButNotSend) {
  EXPECT_NE(say(of_bob).reply.find(R"("name":"bob","role":"viewer")"), std::string::npos);
  EXPECT_TRUE(session.may_watch());
  const auto reaction = say(stop);
  EXPECT_FALSE(reaction.publish);
  EXPECT_NE(reaction.reply.find("bob may watch, but not send commands"), std::string::npos);
}

TEST_F(WebRoles, OperatorAloneReadsNote) {
  tokens.set_note("MQTT: user slam-server\n");
  EXPECT_EQ(say(of_bob).reply.find("slam-server"), std::string::npos);
  EXPECT_NE(say(right).reply.find(R"("note":"MQTT: user slam-server\n")"), std::string::npos);
}

TEST_F(WebRoles, NamesSenderOfCommand) {
  say(right);
  const auto reaction = say(stop);
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->sender, "ada, page at 192.0.2.1");
}

TEST_F(WebRoles, RequireTokenForWatchingWhenViewerIsConfigured) {
  EXPECT_FALSE(session.may_watch());
  say(wrong);
  EXPECT_FALSE(session.may_watch());
  say(right);
  EXPECT_TRUE(session.may_watch());
  say(wrong);
  EXPECT_FALSE(session.may_watch());
}

TEST_F(WebSession, WatchesWithoutTokenWhenNoViewerIsConfigured) {
  EXPECT_TRUE(session.may_watch());
  say(wrong);
  EXPECT_TRUE(session.may_watch());
}

/// Sends each guess on a connection of its own, as a fast attacker does.
class WebTokenGuesses : public WebSession {
 protected:
  PageSession::Reaction guess(std::string client = "192.0.2.1") {
    return of(std::move(client)).on_text(wrong, now);
  }
  void guess_times(int times) {
    for (int i = 0; i < times; ++i) guess();
  }
};

TEST_F(WebTokenGuesses, DelayAnswersAfterFiveWrongTokensFromOneAddress) {
  for (int i = 0; i < 5; ++i) EXPECT_EQ(guess().delay, 0s);
  for (const auto delay : {1s, 2s, 4s, 8s, 16s, 30s, 30s}) EXPECT_EQ(guess().delay, delay);
  guess_times(100);
  EXPECT_EQ(guess().delay, 30s);
  EXPECT_EQ(guess("192.0.2.2").delay, 0s) << "another address";
}

TEST_F(WebTokenGuesses, AreForgottenAfterQuietMinute) {
  guess_times(20);
  now += ClientCounts::quiet_time;
  EXPECT_EQ(guess().delay, 30s);
  now += ClientCounts::quiet_time + 1s;
  EXPECT_EQ(guess().delay, 0s);
}

TEST_F(WebTokenGuesses, AreReportedOnceWithAddressAndNumber) {
  std::string reports;
  for (int i = 0; i < 1000; ++i) reports += guess().report;
  EXPECT_EQ(reports, "6 wrong tokens from 192.0.2.1: answers to more of them are delayed");
  EXPECT_EQ(guesses.total(), 1000u);
  now += ClientCounts::quiet_time + 1s;
  guess_times(5);
  EXPECT_FALSE(guess().report.empty()) << "a new burst";
}

TEST_F(WebTokenGuesses, DoNotDelayRightTokenWhichEndsTheDelays) {
  guess_times(20);
  const auto late = say(wrong);
  EXPECT_EQ(late.delay, 30s);
  const auto reaction = say(right);
  EXPECT_EQ(reaction.delay, 0s);
  EXPECT_TRUE(reaction.drops_delayed_reply) << "else the page would show the token as wrong";
  EXPECT_FALSE(reaction.ends);
  EXPECT_TRUE(say(stop).publish);
  EXPECT_EQ(guess().delay, 0s);
}

TEST_F(WebTokenGuesses, EndConnectionThatDoesNotWaitForDelayedAnswer) {
  guess_times(5);
  EXPECT_FALSE(say(wrong).ends);
  const auto reaction = say(wrong);
  EXPECT_TRUE(reaction.ends);
  EXPECT_EQ(reaction.delay, 0s);
  EXPECT_EQ(guesses.total(), 7u) << "this guess counts, too";
}

TEST(WebClientCounts, ForgetClientThatWasQuietLongest) {
  ClientCounts counts;
  ClientCounts::TimePoint now{};
  for (std::size_t i = 0; i < 3 * ClientCounts::max_clients; ++i) {
    counts.add({"busy"}, now);
    counts.add({std::to_string(i)}, now += 1ms);
  }
  EXPECT_EQ(counts.clients(), ClientCounts::max_clients);
  EXPECT_GT(counts.add({"busy"}, now), 2 * ClientCounts::max_clients);
  EXPECT_EQ(counts.add({"0"}, now), 1u);
}

TEST_F(WebSession, BoundsCommandsPerSecond) {
  say(right);
  int sent = 0;
  for (int i = 0; i < 1000; ++i) sent += say(stop).publish ? 1 : 0;
  EXPECT_EQ(sent, static_cast<int>(PageSession::command_burst));
  now += 1s;
  for (int i = 0; i < 1000; ++i) sent += say(stop).publish ? 1 : 0;
  EXPECT_EQ(sent, static_cast<int>(PageSession::command_burst + PageSession::commands_per_second));
}

}  // namespace
}  // namespace slamgw::web::test
