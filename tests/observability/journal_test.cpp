// SPDX-License-Identifier: Apache-2.0
// What is written to the journal: which robot messages get a line, how an entry looks, and what
// happens when the journal accepts nothing.
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <stdexcept>
#include <vector>

#include "daemon/observability/journal_sink.hpp"
#include "daemon/observability/log_fields.hpp"
#include "daemon/observability/notice_lines.hpp"
#include "daemon/observability/traffic_log.hpp"
#include "daemon/observability/traffic_sampler.hpp"
#include "tests/support/temp_dir.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

TrafficEvent message_of(const std::string& robot) {
  TrafficEvent event;
  event.mesh = Mesh::thread;
  event.robot = robot;
  event.type = "adv";
  return event;
}

// ---- which messages get a line

struct Written {
  std::uint64_t lines = 0;
  std::uint64_t stands_for = 0;
};

/// Sends a thousand messages a second for `time`, from each of `robots` in turn.
Written written_of_a_flood(TrafficLogMode mode, int robots, std::chrono::seconds time) {
  UnprovenLines unproven;
  TrafficSampler sampler(mode, unproven);
  Written written;
  TimePoint now{1h};
  for (std::int64_t i = 0; i < 1000 * time.count(); ++i, now += 1ms) {
    const auto line = sampler.on_traffic(message_of("r" + std::to_string(i % robots)), now);
    if (!line) continue;
    ++written.lines;
    written.stands_for += line->of_stream + line->of_others;
  }
  return written;
}

TEST(TrafficSampler, StaysBelowJournaldsRateLimitInEveryMode) {
  for (const auto mode : {TrafficLogMode::all, TrafficLogMode::sampled}) {
    const Written written = written_of_a_flood(mode, 2000, 30s);
    EXPECT_LE(written.lines, 9000u);
    EXPECT_GE(written.lines, 8500u) << "the limit is used";
    EXPECT_GE(written.stands_for, 29900u) << "all but the last few are counted in a line";
    EXPECT_LE(written.stands_for, 30000u);
  }
}

TEST(TrafficSampler, WritesEveryMessageBelowRateLimit) {
  EXPECT_EQ(written_of_a_flood(TrafficLogMode::all, 1, 3s).lines, 3000u);
  EXPECT_EQ(written_of_a_flood(TrafficLogMode::off, 1, 3s).lines, 0u);
  EXPECT_LE(written_of_a_flood(TrafficLogMode::sampled, 1, 3s).lines, 3u);
}

TEST(TrafficSampler, RefillsBudgetOverTime) {
  TokenBucket budget;
  TimePoint now{};
  int taken = 0;
  while (budget.take(3000U, 200U, now)) ++taken;
  EXPECT_EQ(taken, 3000);
  now += 1s;
  for (taken = 0; budget.take(3000U, 200U, now);) ++taken;
  EXPECT_EQ(taken, 200);
  now += 1h;
  for (taken = 0; budget.take(3000U, 200U, now);) ++taken;
  EXPECT_EQ(taken, 3000);
}

TEST(TrafficText, CountsMessagesThatLineStandsFor) {
  const TrafficEvent event = message_of("r");
  EXPECT_EQ(traffic_text(event, {}), "thread r adv 0 bytes");
  EXPECT_EQ(traffic_text(event, {3, 0}), "thread r adv 0 bytes (3 messages)");
  EXPECT_EQ(traffic_text(event, {1, 7}),
            "thread r adv 0 bytes (and 7 more of any robot: too many to log)");
}

TEST(TrafficText, NamesTheTopicOfAMessageWithoutRobot) {
  TrafficEvent event = message_of("");
  event.topic = "lab/all/adv";
  EXPECT_EQ(traffic_text(event, {}), "thread - lab/all/adv 0 bytes");
}

// ---- how long a message took

std::string latency_of(const LogFields& fields) {
  for (const LogField& field : fields)
    if (field.name == "LATENCY_US") return field.value;
  return "none";
}

TEST(NoticeLines, LimitPresenceOfManyRobotsAndNoOtherNotice) {
  UnprovenLines unproven;
  NoticeLines lines(unproven);
  const TimePoint now{1h};
  const Notice presence{Severity::info, "r1 is online", "r1", Occasion::robot_presence};
  std::int64_t written = 0;
  for (int i = 0; i < 20000; ++i) written += lines.may_write(presence, now) ? 1 : 0;
  EXPECT_EQ(written, NoticeLines::presence_at_once);
  EXPECT_TRUE(lines.may_write(Notice{Severity::warning, "text", {}}, now));
  const auto summaries = lines.summaries();
  ASSERT_EQ(summaries.size(), 1u);
  EXPECT_EQ(summaries[0].text.find("18500 more robots"), 0u) << summaries[0].text;
  EXPECT_TRUE(lines.summaries().empty());
  EXPECT_TRUE(lines.may_write(presence, now + 1s));
}

TEST(NoticeLines, LimitRefusalsOfTheBroker) {
  UnprovenLines unproven;
  NoticeLines lines(unproven);
  const TimePoint now{1h};
  const Notice refusal{Severity::warning, "the broker refuses it", {}, Occasion::broker_refusal};
  std::int64_t written = 0;
  for (int i = 0; i < 1000; ++i) written += lines.may_write(refusal, now) ? 1 : 0;
  EXPECT_EQ(written, NoticeLines::refusals_at_once);
  EXPECT_TRUE(lines.may_write(Notice{Severity::warning, "text", {}}, now));
  const auto summaries = lines.summaries();
  ASSERT_EQ(summaries.size(), 1u);
  EXPECT_EQ(summaries[0].text,
            "980 more lines about messages that the broker refuses: too many to log one by one");
  EXPECT_TRUE(lines.may_write(refusal, now + 1s));
}

TEST(NoticeLines, LimitCommandsOfTheBrokerButNotOfAnOperator) {
  UnprovenLines unproven;
  NoticeLines lines(unproven);
  const TimePoint now{1h};
  Notice command{Severity::info, "r1 cmd delivered", "r1", Occasion::command_outcome};
  command.audit = AuditFacts{"broker: planner", "command cmd", "delivered"};
  Notice order = command;
  order.audit->who = "uid 0 (root)";
  std::int64_t written = 0;
  for (int i = 0; i < 20000; ++i) {
    written += lines.may_write(command, now) ? 1 : 0;
    EXPECT_TRUE(lines.may_write(order, now));
  }
  EXPECT_EQ(written, NoticeLines::commands_at_once);
  EXPECT_TRUE(lines.may_write(Notice{Severity::warning, "text", {}}, now));
  const auto summaries = lines.summaries();
  ASSERT_EQ(summaries.size(), 1u);
  EXPECT_EQ(summaries[0].text.find("19000 more commands"), 0u) << summaries[0].text;
  EXPECT_TRUE(summaries[0].audit) << "the audit trail shows its gap";
  EXPECT_TRUE(lines.summaries().empty());
  EXPECT_TRUE(lines.may_write(command, now + 1s));
}

/// Sends a message a second from each robot for 30 s. Returns the number of lines.
std::int64_t lines_of_unproven(int robots, UnprovenLines& unproven) {
  TrafficSampler sampler(TrafficLogMode::sampled, unproven);
  std::int64_t written = 0;
  TimePoint now{1h};
  for (int i = 0; i < 30 * robots; ++i, now += std::chrono::microseconds(1'000'000 / robots)) {
    TrafficEvent event = message_of("r" + std::to_string(i % robots));
    event.is_proven = false;
    written += sampler.on_traffic(event, now) ? 1 : 0;
  }
  return written;
}

TEST(UnprovenLines, SummarizeFloodAndWriteEveryLineOfFiftyRobots) {
  UnprovenLines few;
  EXPECT_GE(lines_of_unproven(50, few), 29 * 50);
  EXPECT_FALSE(few.summary());
  UnprovenLines many;
  EXPECT_LE(lines_of_unproven(400, many), UnprovenLines::lines_at_once + 40);
  const auto summary = many.summary();
  ASSERT_TRUE(summary);
  EXPECT_NE(summary->text.find("left out "), std::string::npos) << summary->text;
  EXPECT_FALSE(many.summary());
}

TEST(UnprovenLines, KeepRefusalsDuringFloodOfTraffic) {
  UnprovenLines unproven;
  lines_of_unproven(400, unproven);
  EXPECT_TRUE(unproven.may_write("odd-one", TimePoint{1h} + 30s)) << "a refusal of another robot";
}

TEST(UnprovenLines, PassAgainAfterFlood) {
  UnprovenLines lines;
  TimePoint now{1h};
  for (int i = 0; i < 10000; ++i, now += 1ms) lines.may_write("r", now);
  UnprovenLines later = lines;
  EXPECT_FALSE(lines.may_write("r", now)) << "the flood goes on";
  EXPECT_FALSE(lines.may_write("r", now + FloodGate::window)) << "the window is not over";
  EXPECT_TRUE(lines.may_write("r", now + 2 * FloodGate::window));
  EXPECT_TRUE(later.may_write("r", now + 2 * FloodGate::window)) << "no message came since";
}

TEST(UnprovenLines, LeaveBudgetAndStreamsOfProvenRobotsAlone) {
  UnprovenLines unproven;
  NoticeLines presence(unproven);
  TrafficSampler sampler(TrafficLogMode::sampled, unproven);
  const TimePoint now{1h};
  Notice stranger{Severity::info, "r1 is online", "r1", Occasion::robot_presence, {}, false};
  TrafficEvent event = message_of("");
  event.is_proven = false;
  for (std::size_t i = 0; i <= TrafficSampler::max_streams; ++i) {
    presence.may_write(stranger, now);
    event.robot = "r" + std::to_string(i);
    sampler.on_traffic(event, now);
  }
  stranger.is_proven = true;
  EXPECT_TRUE(presence.may_write(stranger, now));
  for (const std::string robot : {"a", "b"}) {
    const auto line = sampler.on_traffic(message_of(robot), now);
    ASSERT_TRUE(line) << "each proven robot has its own stream";
    EXPECT_EQ(line->of_stream + line->of_others, 1u);
  }
}

TEST(TrafficSampler, BoundsStreamsOfRobotThatInventsTypes) {
  UnprovenLines unproven;
  TrafficSampler sampler(TrafficLogMode::sampled, unproven);
  std::size_t written = 0;
  TrafficEvent event = message_of("r");
  for (int type = 0; type < 128; ++type) {
    event.type = std::to_string(type);
    written += sampler.on_traffic(event, TimePoint{1h}) ? 1 : 0;
  }
  EXPECT_EQ(written, TrafficSampler::max_types + 1);
}

class TrafficLogTest : public testing::Test {
 protected:
  bool is_written_at_once(std::uint64_t receipt, Mesh mesh = Mesh::thread) {
    TrafficEvent event = message_of("r" + std::to_string(receipt));
    event.at = now;
    event.receipt = {mesh, receipt};
    const std::size_t before = latencies.size();
    log.on_traffic(event);
    return latencies.size() > before;
  }

  TimePoint now{1h};
  UnprovenLines unproven;
  std::vector<std::string> latencies;  ///< of the lines that were written, in order
  TrafficLog log{TrafficLogMode::all, unproven,
                 [this](const std::string&, const LogFields& fields) {
                   latencies.push_back(latency_of(fields));
                 }};
};

using Latencies = std::vector<std::string>;

TEST_F(TrafficLogTest, LogsLatencyOfAcknowledgement) {
  EXPECT_FALSE(is_written_at_once(1));
  EXPECT_FALSE(is_written_at_once(1, Mesh::ble));
  now += 12345us;
  log.on_receipt({Mesh::thread, 1}, ReceiptOutcome::safe, now);
  log.on_receipt({Mesh::thread, 1}, ReceiptOutcome::safe, now);
  log.on_receipt({Mesh::ble, 1}, ReceiptOutcome::refused, now);
  EXPECT_EQ(latencies, (Latencies{"12345", "none"}));
}

TEST_F(TrafficLogTest, WritesLineWithoutReceiptAtOnce) {
  EXPECT_TRUE(is_written_at_once(0));
  log.on_receipt({Mesh::thread, 0}, ReceiptOutcome::safe, now);
  EXPECT_EQ(latencies, Latencies{"none"});
}

TEST_F(TrafficLogTest, WritesLineWithoutLatencyWhenAcknowledgementIsLate) {
  is_written_at_once(1);
  now += 4s;
  is_written_at_once(2);
  now += 1s;
  log.write_overdue(now);
  EXPECT_EQ(latencies, Latencies{"none"});
  log.on_receipt({Mesh::thread, 1}, ReceiptOutcome::safe, now);
  log.on_receipt({Mesh::thread, 2}, ReceiptOutcome::safe, now);
  EXPECT_EQ(latencies, (Latencies{"none", "1000000"}));
}

TEST_F(TrafficLogTest, BoundsWaitingLines) {
  for (std::uint64_t i = 1; i <= TrafficLog::max_awaiting; ++i) EXPECT_FALSE(is_written_at_once(i));
  EXPECT_TRUE(is_written_at_once(TrafficLog::max_awaiting + 1));
}

// ---- what an entry looks like

TEST(JournalEntry, HasOneFieldPerLine) {
  EXPECT_EQ(journal_entry("slam-gateway-web", Severity::warning, "text", {{"ROBOT_ID", "r=1"}}),
            "MESSAGE=text\nPRIORITY=4\nSYSLOG_IDENTIFIER=slam-gateway-web\nROBOT_ID=r=1\n");
}

TEST(JournalEntry, EncodesValueWithLineFeedByItsLength) {
  const std::string entry =
      journal_entry("slam-gatewayd", Severity::info, "", {{"TOPIC", "a\nPRIORITY=0"}});
  const std::string expected("TOPIC\n\x0c\0\0\0\0\0\0\0a\nPRIORITY=0\n", 6 + 8 + 12 + 1);
  EXPECT_NE(entry.find(expected), std::string::npos) << "a value cannot forge a field";
}

TEST(JournalEntry, HasThePriorityThatJournalctlSelectsBy) {
  EXPECT_EQ(journal_priority(Severity::debug), 7);
  EXPECT_EQ(journal_priority(Severity::info), 6);
  EXPECT_EQ(journal_priority(Severity::notice), 5);
  EXPECT_EQ(journal_priority(Severity::warning), 4);
  EXPECT_EQ(journal_priority(Severity::error), 3);
}

// ---- a journal that accepts nothing

/// The socket of journald, which is read on request.
class Journald {
 public:
  explicit Journald(const std::string& path) {
    unlink(path.c_str());
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof address.sun_path - 1);
    socket_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const auto* generic = reinterpret_cast<const sockaddr*>(&address);
    if (bind(socket_, generic, sizeof address) != 0) throw std::runtime_error(std::strerror(errno));
  }
  ~Journald() { close(socket_); }

  /// Returns the messages of the entries received since, in order.
  std::vector<std::string> take() {
    std::vector<std::string> messages;
    char entry[4096];
    for (ssize_t size = 0; (size = recv(socket_, entry, sizeof entry, 0)) >= 0;) {
      const std::string text(entry, static_cast<std::size_t>(size));
      messages.push_back(text.substr(8, text.find('\n') - 8));
    }
    return messages;
  }

 private:
  int socket_ = -1;
};

class JournalSinkIo : public testing::Test {
 protected:
  void log(Severity severity, const std::string& text) {
    context.severity = severity;
    sink.log(spdlog::details::log_msg("", spdlog::level::info, text));
    sink.flush();
  }
  /// Logs until the journal accepts no more, as at 1 000 messages a second.
  void flood() {
    for (int i = 0; i < 20000; ++i) log(Severity::info, "traffic");
  }

  test::TempDir directory;
  const std::string path = directory / "journal";
  Journald journald{path};
  LogContext context;
  JournalSink sink{context, path};
};

TEST_F(JournalSinkIo, KeepsWarningsWhileJournalIsStuckAndCountsLostEntries) {
  flood();
  log(Severity::warning, "first");
  log(Severity::notice, "second");
  flood();
  const std::size_t before = journald.take().size();
  sink.flush();
  const auto after = journald.take();
  ASSERT_EQ(after.size(), 3u);
  EXPECT_EQ(after[0], "first");
  EXPECT_EQ(after[1], "second");
  EXPECT_EQ(after[2], std::to_string(40000 - before) +
                          " log entries are lost: the journal did not take them");
  log(Severity::info, "traffic");
  EXPECT_EQ(journald.take(), std::vector<std::string>{"traffic"}) << "reported once";
}

TEST_F(JournalSinkIo, AsksForARetryWhileEntriesAreKept) {
  int asked = 0;
  context.when_kept = [&asked] { ++asked; };
  flood();
  EXPECT_EQ(asked, 0) << "nothing is kept";
  log(Severity::warning, "first");
  EXPECT_EQ(asked, 1);
  sink.flush();
  EXPECT_EQ(asked, 2) << "the journal is still stuck";
  journald.take();
  sink.flush();
  EXPECT_EQ(asked, 2);
  EXPECT_EQ(journald.take().front(), "first");
}

TEST_F(JournalSinkIo, BoundsKeptWarnings) {
  flood();
  for (int i = 0; i < 10000; ++i) log(Severity::warning, "warning " + std::to_string(i));
  std::vector<std::string> all = journald.take();
  std::size_t warnings = 0;
  do {
    for (const std::string& message : all) warnings += message.starts_with("warning ") ? 1 : 0;
    sink.flush();
    all = journald.take();
  } while (!all.empty());
  EXPECT_EQ(warnings, JournalSocket::max_kept);
}

TEST_F(JournalSinkIo, ReconnectsToRestartedJournal) {
  unlink(path.c_str());
  log(Severity::warning, "while it is away");
  Journald restarted(path);
  log(Severity::info, "next");
  EXPECT_EQ(restarted.take(), (std::vector<std::string>{"while it is away", "next"}));
}

TEST_F(JournalSinkIo, CountsTooLargeEntryAsLostAndGoesOn) {
  log(Severity::warning, std::string(16 << 20, 'x'));
  log(Severity::info, "next");
  const auto messages = journald.take();
  ASSERT_EQ(messages.size(), 2u);
  EXPECT_EQ(messages[0], "1 log entries are lost: the journal did not take them");
  EXPECT_EQ(messages[1], "next");
}

}  // namespace
}  // namespace slamgw
