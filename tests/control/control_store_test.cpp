// SPDX-License-Identifier: Apache-2.0
// `slam-gatewayctl store ...`: what it orders and what it shows.
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/control/control_program_fixture.hpp"

namespace slamgw::test {
namespace {

class ControlStoreIo : public ControlProgramIo {
 protected:
  void SetUp() override { start(); }
  Ended order(std::vector<std::string> arguments, std::deque<OrderAnswer> answers) {
    handler.store_orders.clear();
    handler.store_answers = std::move(answers);
    arguments.insert(arguments.begin(), "store");
    return run(std::move(arguments));
  }
  template <class T>
  T ordered(std::size_t index = 0) {
    if (index >= handler.store_orders.size()) return {};
    const auto* const found = std::get_if<T>(&handler.store_orders[index].order);
    EXPECT_TRUE(found);
    return found ? *found : T{};
  }

  const OrderAnswer first_page_{
      R"({"count":3,"bytes":2048,"more":true,"letters":[
        {"id":7,"topic":"ntnu-slam/robot/r1/update","bytes":12,"tries":5,"code":135,
         "reason":"not authorised","stored_at":"2000-01-01T00:00:00Z"},
        {"id":9,"topic":"ntnu-slam/robot/r1/\u001b[2J","bytes":0,"tries":0,
         "reason":"topic name invalid","stored_at":"2000-01-01T00:00:00Z"}]})",
      {}};
  const OrderAnswer second_page_{
      R"({"count":3,"bytes":2048,"more":true,"letters":[{"id":12,"topic":"t","reason":"r"}]})", {}};
  const OrderAnswer end_{R"({"count":3,"bytes":2048,"more":false,"letters":[]})", {}};
};

TEST_F(ControlStoreIo, ListsAllPages) {
  const Ended result = order({"list"}, {first_page_, second_page_, end_});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_NE(result.out.find("3 dead letters, 2.0 KiB\n"), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("       7 "), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("ntnu-slam/robot/r1/update: not authorised\n"), std::string::npos);
  EXPECT_NE(result.out.find("t: r\n"), std::string::npos);
  EXPECT_EQ(result.out.find('\x1b'), std::string::npos) << "a robot chooses its topic names";
  EXPECT_EQ(ordered<ListDeadLetters>(0).after, 0u);
  EXPECT_EQ(ordered<ListDeadLetters>(1).after, 9u);
  EXPECT_EQ(ordered<ListDeadLetters>(2).after, 12u);
  EXPECT_FALSE(ordered<ListDeadLetters>(0).with_payloads);
  EXPECT_EQ(order({"list"}, {{R"({"count":0,"letters":[],"more":false})", {}}}).out,
            "no dead letters\n");
}

TEST_F(ControlStoreIo, ShowsTotalCountSeparatelyWhenListingOneTopic) {
  const Ended result = order({"list", "--topic", "t"}, {second_page_, end_});
  EXPECT_TRUE(result.out.starts_with("of this topic, of 3 dead letters, 2.0 KiB in all:\n"))
      << result.out;
}

TEST_F(ControlStoreIo, ListsAsOneJsonDocument) {
  const Ended result = order({"list", "--json", "--topic", "t"}, {first_page_, second_page_, end_});
  const json document = json::parse(result.out, nullptr, false);
  ASSERT_FALSE(document.is_discarded()) << result.out;
  EXPECT_EQ(document["count"], 3);
  EXPECT_EQ(document["letters"].size(), 3u);
  EXPECT_EQ(ordered<ListDeadLetters>(0).topic, "t");
}

TEST_F(ControlStoreIo, ExportsOneDocumentPerLineWithPayloads) {
  const Ended result = order({"export"}, {first_page_, second_page_, end_});
  EXPECT_TRUE(ordered<ListDeadLetters>(0).with_payloads);
  std::istringstream lines(result.out);
  std::vector<int> ids;
  for (std::string line; std::getline(lines, line);) ids.push_back(json::parse(line)["id"]);
  EXPECT_EQ(ids, (std::vector<int>{7, 9, 12}));
}

TEST_F(ControlStoreIo, ReportsEmptyStore) {
  const OrderAnswer none{R"({"count":0,"letters":[],"more":false})", {}};
  EXPECT_EQ(order({"list", "--topic", "t"}, {end_}).out,
            "no dead letters of this topic; of others: 3\n");
  const Ended result = order({"export"}, {none});
  EXPECT_EQ(result.status, 0);
  EXPECT_EQ(result.out, "");
  EXPECT_EQ(result.err, "slam-gatewayctl: no dead letters\n");
}

TEST_F(ControlStoreIo, HelpNamesOrderOfResentLetters) {
  EXPECT_NE(order({"resend", "--help"}, {}).out.find("before messages that were stored later"),
            std::string::npos);
}

TEST_F(ControlStoreIo, ResendsAndReportsRemainingLetters) {
  Ended result = order({"resend", "7", "9"}, {{R"({"resent":2,"left":0})", {}}});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "2 dead letters are sent again\n");
  EXPECT_EQ(ordered<ResendOrder>().choice.ids, (std::vector<std::uint64_t>{7, 9}));
  result = order({"resend", "--all"}, {{R"({"resent":1,"left":2})", {}}});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.out.find("2 remain"), std::string::npos) << result.out;
  EXPECT_TRUE(ordered<ResendOrder>().choice.is_all);
}

TEST_F(ControlStoreIo, DiscardsLettersOfNamedTopic) {
  const Ended result = order({"discard", "--topic", "a/b"}, {{R"({"discarded":4})", {}}});
  EXPECT_EQ(result.out, "4 dead letters were discarded\n");
  EXPECT_EQ(ordered<DiscardOrder>().choice.topic, "a/b");
  EXPECT_FALSE(ordered<DiscardOrder>().choice.is_all);
}

TEST_F(ControlStoreIo, FailsWhenNamedLetterDoesNotExist) {
  const std::string remedy = "; slam-gatewayctl store list shows all\n";
  Ended result = order({"discard", "99"}, {{R"({"discarded":0})", {}}});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err, "slam-gatewayctl: there is no such dead letter" + remedy);
  result = order({"discard", "--json", "--topic", "a/b"}, {{R"({"discarded":0})", {}}});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.out, "{\"discarded\":0}\n");
  result = order({"discard", "7", "7", "98", "99"}, {{R"({"discarded":1})", {}}});
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.err, "slam-gatewayctl: 2 of these dead letters are not there" + remedy);
  EXPECT_EQ(order({"discard", "7", "7"}, {{R"({"discarded":1})", {}}}).status, 0);
  EXPECT_EQ(order({"discard", "--all"}, {{R"({"discarded":0})", {}}}).status, 0);
  EXPECT_EQ(order({"resend", "99"}, {{R"({"resent":0,"left":0})", {}}}).status, 1);
  EXPECT_EQ(order({"resend", "--all"}, {{R"({"resent":0,"left":0})", {}}}).status, 0);
}

TEST_F(ControlStoreIo, RequiresExactlyOneChoiceOfLetters) {
  EXPECT_EQ(order({"discard"}, {}).status, 2);
  EXPECT_EQ(order({"resend"}, {}).status, 2);
  EXPECT_EQ(order({"discard", "7", "--all"}, {}).status, 2);
  for (const char* const id : {"seven", "-1", "99999999999999999999999", "7x", "0x7"}) {
    EXPECT_EQ(order({"discard", id}, {}).status, 2) << id;
    EXPECT_EQ(order({"resend", "7", id}, {}).status, 2) << id;
  }
  EXPECT_TRUE(handler.store_orders.empty());
}

TEST_F(ControlStoreIo, ShowsFailureOfTheDaemon) {
  const Ended result = order({"list"}, {{"", "there is no store: the disk is full"}});
  EXPECT_EQ(result.status, 1);
  EXPECT_NE(result.err.find("there is no store: the disk is full"), std::string::npos);
}

TEST(StoreWire, RefusesMissingInvalidOrDoubleChoice) {
  for (const char* const line :
       {R"({"command":"store discard"})", R"({"command":"store discard","ids":[]})",
        R"({"command":"store discard","ids":["1"]})", R"({"command":"store discard","ids":[-1]})",
        R"({"command":"store discard","ids":7})", R"({"command":"store discard","all":false})",
        R"({"command":"store resend","all":true,"topic":"t"})", R"({"command":"store burn"})"}) {
    EXPECT_FALSE(control::parse_request(line)) << line;
  }
  EXPECT_TRUE(control::parse_request(R"({"command":"store discard","all":true})"));
}

}  // namespace
}  // namespace slamgw::test
