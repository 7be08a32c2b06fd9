// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/log_fields.hpp"

#include <gtest/gtest.h>

#include <set>

#include "daemon/observability/audit_notice.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

TEST(NoticeFields, NameOccasionRobotAndLatency) {
  const LogFields fields = notice_fields(
      {Severity::info, "text", "NRF_5", Occasion::command_outcome, std::chrono::milliseconds(12)});
  ASSERT_EQ(fields.size(), 3U);
  EXPECT_EQ(fields[0].value, message_id_of(Occasion::command_outcome));
  EXPECT_EQ(fields[1].value, "NRF_5");
  EXPECT_EQ(fields[2].value, "12000");
  EXPECT_TRUE(notice_fields({Severity::info, "text", {}}).empty());
}

std::string value_of(const LogFields& fields, std::string_view name) {
  for (const LogField& field : fields)
    if (field.name == name) return field.value;
  return "none";
}

TEST(NoticeFields, NameMeshTypeAndDirection) {
  Notice notice{Severity::info, "text", "r", Occasion::command_outcome};
  EXPECT_EQ(value_of(notice_fields(notice), "DIRECTION"), "none");
  notice.mesh = Mesh::ble;
  notice.type = "cmd";
  EXPECT_EQ(value_of(notice_fields(notice), "MESH"), "ble");
  EXPECT_EQ(value_of(notice_fields(notice), "MESSAGE_TYPE"), "cmd");
  EXPECT_EQ(value_of(notice_fields(notice), "DIRECTION"), "down");
  notice.occasion = Occasion::rejected_payload;
  EXPECT_EQ(value_of(notice_fields(notice), "DIRECTION"), "up");
}

TEST(NoticeFields, NameUserRequestAndOutcome) {
  const Notice notice =
      audit_notice("uid 7 (ann)", {"forget", "r1"}, {{}, "it is online\nand more"});
  EXPECT_EQ(notice.text, "forget r1: failed: it is online; asked by uid 7 (ann)");
  const LogFields fields = notice_fields(notice);
  EXPECT_EQ(value_of(fields, "SLAM_AUDIT"), "1");
  EXPECT_EQ(value_of(fields, "SLAM_AUDIT_WHO"), "uid 7 (ann)");
  EXPECT_EQ(value_of(fields, "SLAM_AUDIT_WHAT"), "forget");
  EXPECT_EQ(value_of(fields, "SLAM_AUDIT_OUTCOME"), "failed");
  EXPECT_EQ(value_of(fields, "ROBOT_ID"), "r1");
  const Notice done = audit_notice("SIGHUP", {"reload", {}}, {});
  EXPECT_EQ(done.text, "reload: done; asked by SIGHUP");
  EXPECT_EQ(value_of(notice_fields(done), "SLAM_AUDIT_OUTCOME"), "done");
  EXPECT_EQ(value_of(notice_fields({Severity::info, "text", {}}), "SLAM_AUDIT"), "none");
}

TEST(AuditNotice, AuditsOnlyChangesAndShowsNoKey) {
  EXPECT_FALSE(audited(BleOrder{ScanOrder{}}));
  EXPECT_FALSE(audited(BleOrder{NodesOrder{}}));
  EXPECT_FALSE(audited(BleOrder{JoinEventsOrder{}}));
  EXPECT_FALSE(audited(StoreOrder{ListDeadLetters{}}));
  const auto joins = audited(BleOrder{PermitJoinOrder{std::chrono::minutes{5}, "r1"}});
  ASSERT_TRUE(joins);
  EXPECT_EQ(joins->what, "ble permit-join 5 min");
  EXPECT_EQ(joins->robot, "r1");
  EXPECT_EQ(audited(BleOrder{PermitJoinOrder{std::chrono::seconds{30}, {}}})->what,
            "ble permit-join 30 s");
  EXPECT_EQ(audited(BleOrder{PermitJoinOrder{}})->what, "ble permit-join closed");
  const auto imported = audited(BleOrder{ImportOrder{"00112233445566778899aabbccddeeff"}});
  ASSERT_TRUE(imported);
  EXPECT_EQ(audit_notice("uid 0", *imported, {}).text, "ble import: done; asked by uid 0");
}

TEST(AuditNotice, NamesDiscardedAndResentDeadLetters) {
  const auto line = [](const DeadLetterChoice& choice, const std::string& answer) {
    return audit_notice("uid 0", *audited(StoreOrder{DiscardOrder{choice}}), {answer, {}}).text;
  };
  EXPECT_EQ(line({{17, 18}, {}, false}, R"({"discarded":1})"),
            "store discard 17 18: done (1 dead letter); asked by uid 0");
  EXPECT_EQ(line({{}, "p/robot/r1/a", false}, R"({"discarded":5})"),
            "store discard --topic p/robot/r1/a: done (5 dead letters); asked by uid 0");
  EXPECT_EQ(line({{}, {}, true}, R"({"discarded":0})"),
            "store discard --all: done (0 dead letters); asked by uid 0");
  EXPECT_EQ(line({std::vector<std::uint64_t>(300, 7), {}, false}, R"({"discarded":1})")
                .find(" and 200 more: done"),
            14 + 100 * 2u - 1);
  EXPECT_EQ(line({{99}, {}, false}, R"({"discarded":0})"),
            "store discard 99: failed: there is no such dead letter; asked by uid 0");
  EXPECT_EQ(audited(StoreOrder{DiscardOrder{{{}, {}, true}}})->what, "store discard");
  const auto again = audited(StoreOrder{ResendOrder{{{}, {}, true}}});
  EXPECT_EQ(audit_notice("uid 0", *again, {R"({"resent":2,"left":1})", {}}).text,
            "store resend --all: done (2 dead letters); asked by uid 0");
}

TEST(AuditNotice, EscapesANameThatNoRobotCanHave) {
  const auto robot_of = [](const std::string& name) {
    return value_of(notice_fields(audit_notice("uid 0", {"forget", name}, {})), "ROBOT_ID");
  };
  EXPECT_EQ(robot_of("x\x1b[1m"), "x\\x1b[1m");
  EXPECT_EQ(robot_of("r\u0435"), "r\u0435") << "a Cyrillic letter: some robot may have it";
}

TEST(UserWords, NameTheUsersOfThisHost) {
  EXPECT_EQ(user_words(0), "uid 0 (root)");
  EXPECT_EQ(user_words(4'000'000'000U), "uid 4000000000");
}

TEST(UserWords, FindAUserBehindALongLine) {
  const test::TempDir directory;
  const std::string users = directory / "passwd";
  test::write_file(
      users, "long:x:5:5:" + std::string(20'000, 'n') + ":/:/bin/sh\nalice:x:6:6::/:/bin/sh\n");
  EXPECT_EQ(user_words(5, users.c_str()), "uid 5 (long)");
  EXPECT_EQ(user_words(6, users.c_str()), "uid 6 (alice)");
}

TEST(NoticeFields, HaveDistinctIdForEachOccasion) {
  std::set<std::string_view> ids;
  for (int i = 1; i <= static_cast<int>(Occasion::broker_link); ++i) {
    const std::string_view id = message_id_of(static_cast<Occasion>(i));
    EXPECT_EQ(id.size(), 32U);
    EXPECT_TRUE(ids.insert(id).second) << i;
  }
}

}  // namespace
}  // namespace slamgw
