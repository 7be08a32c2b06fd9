// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::ble {

namespace {

constexpr std::string_view run_type = "run";
constexpr std::size_t position_bytes = 4;
constexpr std::size_t vendor_opcode_bytes = 3;

std::optional<bool> parse_run(ByteView payload) {
  constexpr std::array<std::string_view, 4> on{"1", "on", "start", "unpause"};
  constexpr std::array<std::string_view, 4> off{"0", "off", "stop", "pause"};
  if (payload.size() == 1 && payload.front() <= 1) return payload.front() == 1;
  if (std::ranges::find(on, as_text(payload)) != on.end()) return true;
  if (std::ranges::find(off, as_text(payload)) != off.end()) return false;
  return std::nullopt;
}

Command vendor_command(std::string_view type, VendorModel model, ByteView payload) {
  return {.type = std::string(type),
          .access = encode_access(opcode_of({model, MessageKind::set}), payload),
          .awaited_status = opcode_of({model, MessageKind::status}),
          .is_replaceable = model == VendorModel::pos_cmd};
}

}  // namespace

Result<Command, Refusal> make_command(const Settings& settings, std::string_view type,
                                      ByteView payload, std::uint8_t tid,
                                      std::size_t max_send_bytes) {
  if (type == settings.pos_cmd_type) {
    if (payload.size() == position_bytes)
      return vendor_command(type, VendorModel::pos_cmd, payload);
    return Refusal{fmt::format("{} takes 4 bytes (x and y, int16 little-endian, in cm), not {}",
                               type, payload.size())};
  }
  if (type == run_type) {
    const auto is_on = parse_run(payload);
    if (!is_on) return Refusal{"run takes 0, 1, off, on, stop, start, pause or unpause"};
    return Command{.type = std::string(type),
                   .access = encode_on_off_set(settings.on_off_model, *is_on, tid),
                   .awaited_status = on_off_status(settings.on_off_model),
                   .is_replaceable = false};
  }
  if (payload.size() + vendor_opcode_bytes > max_send_bytes)
    return Refusal{fmt::format("{} bytes are too many: the radio sends at most {}", payload.size(),
                               max_send_bytes - vendor_opcode_bytes)};
  return vendor_command(type, VendorModel::min_com, payload);
}

namespace {

using std::chrono::duration_cast;
using std::chrono::milliseconds;

std::int64_t epoch_ms(WallTime time) {
  return duration_cast<milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

Bytes encode_open_commands(const OpenCommands& commands, const Now& now) {
  ByteWriter out;
  for (const OpenCommand& command : commands) {
    const auto age = duration_cast<milliseconds>(now.mono - command.arrived);
    out.write_u64_le(static_cast<std::uint64_t>(epoch_ms(now.wall) - age.count()));
    out.write_u8(command.is_sent ? 1 : 0);
    out.write_u16_le(static_cast<std::uint16_t>(command.type.size())).write(command.type);
  }
  return out.take();
}

OpenCommands decode_open_commands(ByteView octets, const Now& now) {
  OpenCommands commands;
  ByteReader in(octets);
  while (in.remaining() > 0) {
    const auto arrived_ms = static_cast<std::int64_t>(in.read_u64_le());
    const bool is_sent = in.read_u8() != 0;
    const std::string type(as_text(in.read(in.read_u16_le())));
    if (!in.ok()) break;
    const std::int64_t now_ms = epoch_ms(now.wall);
    const milliseconds age{now_ms - std::clamp<std::int64_t>(arrived_ms, 0, now_ms)};
    commands.push_back({type, now.mono - age, is_sent});
  }
  return commands;
}

CommandOutcome outcome_after_restart(const std::string& robot, const OpenCommand& command,
                                     TimePoint now) {
  return {Mesh::ble,
          CommandId::none,
          robot,
          command.type,
          command.is_sent ? CommandResult::timeout : CommandResult::refused,
          duration_cast<milliseconds>(now - command.arrived),
          command.is_sent ? "slam-gatewayd was restarted before the robot answered"
                          : "slam-gatewayd was restarted before it was sent"};
}

EndedCommand CommandQueue::Entry::end(TimePoint now, CommandResult result, std::string why) const {
  return {{Mesh::ble,
           command.id,
           {},
           command.type,
           result,
           duration_cast<milliseconds>(now - arrived),
           std::move(why)},
          {}};
}

EndedCommands CommandQueue::add(Command command, TimePoint now) {
  EndedCommands ended;
  const TimePoint arrived = now - command.message.waited;
  Entry added{std::move(command), arrived};
  const auto older = std::ranges::find_if(waiting_, [&](const Entry& entry) {
    return added.command.is_replaceable && entry.command.type == added.command.type;
  });
  if (older != waiting_.end()) {
    ended.push_back(older->end(now, CommandResult::superseded,
                               "replaced by a newer command before it was sent"));
    *older = std::move(added);
  } else if (waiting_.size() >= max_waiting) {
    ended.push_back(added.end(now, CommandResult::refused,
                              "too many commands are waiting for this robot (at most 16)"));
  } else {
    waiting_.push_back(std::move(added));
  }
  return ended;
}

EndedCommands CommandQueue::on_status(Opcode status, TimePoint now) {
  if (!outstanding_ || outstanding_->entry.command.awaited_status != status) return {};
  if (outstanding_->copies == 1) {
    answer_time_.on_answer(now - outstanding_->first_sent);
  } else {
    answer_time_.on_repeated();
    expect_late_answers(now);
  }
  return {end_outstanding(CommandResult::delivered, {}, now)};
}

EndedCommand CommandQueue::end_outstanding(CommandResult result, std::string why, TimePoint now) {
  Entry entry = std::move(std::exchange(outstanding_, std::nullopt)->entry);
  EndedCommand ended = entry.end(now, result, std::move(why));
  ended.access = std::move(entry.command.access);
  return ended;
}

void CommandQueue::expect_late_answers(TimePoint now) {
  const Command& command = outstanding_->entry.command;
  late_answers_until_[command.awaited_status] =
      now + reliable_interval(ttl_, command.access.size());
}

void CommandQueue::on_send_refused(const std::string& why) {
  if (outstanding_) outstanding_->refusal = why;
}

EndedCommands CommandQueue::on_deadline(TimePoint now) {
  EndedCommands ended;
  if (outstanding_ && outstanding_->entry.is_overdue(now)) {
    answer_time_.on_repeated();
    expect_late_answers(now);
    const std::string refusal = outstanding_->refusal;
    ended.push_back(end_outstanding(CommandResult::timeout,
                                    refusal.empty() ? "the robot did not answer" : refusal, now));
  }
  std::erase_if(waiting_, [&](const Entry& entry) {
    if (!entry.is_overdue(now)) return false;
    ended.push_back(entry.end(now, CommandResult::timeout, "not sent: it waited too long"));
    return true;
  });
  return ended;
}

EndedCommands CommandQueue::end_all(const std::string& why, TimePoint now) {
  EndedCommands ended = end_sent(why, now);
  for (const Entry& entry : waiting_) ended.push_back(entry.end(now, CommandResult::refused, why));
  waiting_.clear();
  return ended;
}

EndedCommands CommandQueue::end_sent(const std::string& why, TimePoint now) {
  if (!outstanding_) return {};
  expect_late_answers(now);
  return {end_outstanding(CommandResult::timeout, why, now)};
}

std::vector<WaitingMessage> CommandQueue::take_waiting(TimePoint now) {
  std::vector<WaitingMessage> taken;
  for (Entry& entry : std::exchange(waiting_, {})) {
    entry.command.message.waited = std::chrono::duration_cast<Waited>(now - entry.arrived);
    taken.push_back({std::move(entry.command.message), entry.command.id});
  }
  return taken;
}

std::optional<CommandQueue::Transmission> CommandQueue::next_transmission(TimePoint now) {
  if (outstanding_) {
    if (outstanding_->entry.is_overdue(now)) return std::nullopt;
    if (now < outstanding_->first_sent + outstanding_->next_offset) return std::nullopt;
    // Doubles several times after a long pause: missed repeats are not sent in a burst.
    while (now >= outstanding_->first_sent + outstanding_->next_offset)
      outstanding_->next_offset *= 2;
    ++outstanding_->copies;
    return Transmission{outstanding_->entry.command, true};
  }
  if (waiting_.empty() || waiting_.front().is_overdue(now) || now < earliest_start())
    return std::nullopt;
  const Duration offset = first_repeat(waiting_.front().command);
  outstanding_ = Outstanding{std::move(waiting_.front()), now, offset, 1, {}};
  waiting_.pop_front();
  return Transmission{outstanding_->entry.command, false};
}

Duration CommandQueue::first_repeat(const Command& command) const {
  const Duration interval = reliable_interval(ttl_, command.access.size());
  return segments_of(command.access.size()) > 1 ? interval : answer_time_.timeout(interval);
}

/// Returns when the first waiting command may start.
TimePoint CommandQueue::earliest_start() const {
  const auto late = late_answers_until_.find(waiting_.front().command.awaited_status);
  return late == late_answers_until_.end() ? TimePoint::min() : late->second;
}

OpenCommands CommandQueue::open_commands() const {
  OpenCommands open;
  if (outstanding_)
    open.push_back({outstanding_->entry.command.type, outstanding_->entry.arrived, true});
  for (const Entry& entry : waiting_) open.push_back({entry.command.type, entry.arrived, false});
  return open;
}

std::optional<TimePoint> CommandQueue::deadline(bool may_send) const {
  std::optional<TimePoint> next;
  if (outstanding_) {
    next = outstanding_->entry.arrived + time_limit;
    if (may_send) next = earlier(next, outstanding_->first_sent + outstanding_->next_offset);
  } else if (may_send && !waiting_.empty()) {
    next = earliest_start();
  }
  for (const Entry& entry : waiting_) next = earlier(next, entry.arrived + time_limit);
  return next;
}

}  // namespace slamgw::ble
