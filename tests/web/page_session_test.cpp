// SPDX-License-Identifier: Apache-2.0
#include "web/server/page_session.hpp"

#include <gtest/gtest.h>

namespace slamgw::web::test {
namespace {

using namespace std::chrono_literals;

class WebSession : public testing::Test {
 protected:
  Topics topics{"ntnu-slam"};
  std::string token = "0123456789abcdef";
  PageSession session{topics, token};
  PageSession::TimePoint now{};

  PageSession::Reaction say(std::string_view text) { return session.on_text(text, now); }
  static constexpr const char* right = R"({"topic":"$web/token","payload":"0123456789abcdef"})";
  static constexpr const char* stop = R"({"topic":"ntnu-slam/server/r/run","payload":"stop"})";
};

TEST_F(WebSession, OnlyWatchesUntilItHasToldTheToken) {
  EXPECT_FALSE(say(stop).publish);
  EXPECT_NE(say(stop).reply.find("$web/refused"), std::string::npos);
  EXPECT_NE(say(right).reply.find("\"accepted\":true"), std::string::npos);
  const auto reaction = say(stop);
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->topic, "ntnu-slam/server/r/run");
  EXPECT_EQ(reaction.publish->payload, "stop");
}

TEST_F(WebSession, PayloadsInHexAreOctets) {
  say(right);
  const auto reaction =
      say(R"({"topic":"ntnu-slam/server/r/cmd","payload":"0a00ecff","encoding":"hex"})");
  ASSERT_TRUE(reaction.publish);
  EXPECT_EQ(reaction.publish->payload, std::string("\x0a\0\xec\xff", 4));
}

TEST_F(WebSession, PublishesNothingButCommands) {
  say(right);
  for (const char* topic : {"ntnu-slam/robot/r/update", "ntnu-slam/gateway/g/state", "x",
                            "ntnu-slam/server/r", "ntnu-slam/server/r/+", "$SYS/x"})
    EXPECT_FALSE(say(R"({"payload":"1","topic":")" + std::string(topic) + "\"}").publish) << topic;
}

TEST_F(WebSession, BadMessagesAreRefusedAndHarmNothing) {
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
  constexpr const char* wrong = R"({"topic":"$web/token","payload":"guess"})";
  EXPECT_FALSE(say(wrong).ends);
  EXPECT_FALSE(say(wrong).ends);
  EXPECT_TRUE(say(wrong).ends);
  EXPECT_FALSE(say(stop).publish);
}

TEST_F(WebSession, AWrongTokenTakesTheRightBack) {
  say(right);
  say(R"({"topic":"$web/token","payload":""})");
  EXPECT_FALSE(say(stop).publish);
}

TEST_F(WebSession, NobodyKnowsATokenThatIsNotSet) {
  const std::string none;
  PageSession watching(topics, none);
  watching.on_text(R"({"topic":"$web/token","payload":""})", now);
  EXPECT_FALSE(watching.on_text(stop, now).publish);
}

TEST_F(WebSession, SendsSoManyCommandsASecond) {
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
