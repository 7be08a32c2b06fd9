// SPDX-License-Identifier: Apache-2.0
// The link's life; what goes over it is in board_link_traffic.cpp.
#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::ble {
BoardLink::BoardLink(LinkSettings settings, std::optional<MeshKeys> keys, std::uint64_t seed)
    : settings_(std::move(settings)), keys_(keys), resync_(seed) {}

void BoardLink::on_port_open(TimePoint now) { begin_resync(now); }

void BoardLink::on_port_closed(const std::string& why, TimePoint) {
  stage_ = Stage::closed;
  in_flight_.reset();
  go_down(why);
}

void BoardLink::change_keys(const MeshKeys& keys, TimePoint now) {
  keys_ = keys;
  if (stage_ == Stage::closed) return;
  go_down("the mesh's keys were imported");
  begin_resync(now);
}

// --- Getting in step -----------------------------------------------------------------------------

void BoardLink::begin_resync(TimePoint now) {
  stage_ = Stage::resyncing;
  is_command_repeated_ = is_command_repeated_ || (in_flight_ && in_flight_->is_command);
  in_flight_.reset();
  decoder_.reset();
  ++counters_.resyncs;
  actions_.push(WriteSerial{resync_.start(now)});
}

void BoardLink::begin_start_up(TimePoint now) {
  stage_ = Stage::starting;
  in_flight_.reset();
  start_up_.emplace(settings_.board, keys_);
  continue_start_up(now);
}

void BoardLink::continue_start_up(TimePoint now) {
  for (Notice& notice : start_up_->take_notices()) say_once(notice.severity, notice.text);
  switch (start_up_->state()) {
    case StartUp::State::commanding: issue(start_up_->command(), 0, now); break;
    case StartUp::State::needs_keys:
      stage_ = Stage::awaiting_keys;
      actions_.push(GenerateKeys{});
      break;
    case StartUp::State::refused:
      stage_ = Stage::refused;
      retry_at_ = now + refusal_interval;
      go_down(start_up_->refusal());
      say_once(Severity::error, start_up_->refusal());
      issue_clear(now);
      break;
    case StartUp::State::done: on_started(now); break;
  }
}

void BoardLink::on_started(TimePoint now) {
  stage_ = Stage::running;
  addresses_ = start_up_->take_addresses();
  version_ = start_up_->version();
  subnet_handle_ = start_up_->subnet_handle();
  appkey_handle_ = start_up_->appkey_handle();
  if (start_up_->dropped_events()) on_drop_counter(*start_up_->dropped_events(), now);
  poll_at_ = now + poll_interval;
  reopen_delay_ = first_reopen_delay;
  if (!std::exchange(is_up_, true)) {
    down_reason_.clear();
    actions_.push(LinkIsUp{start_up_->description()});
  }
  send_next(now);
}

void BoardLink::on_keys(const MeshKeys& keys, TimePoint now) {
  keys_ = keys;
  if (stage_ != Stage::awaiting_keys) return;  // the port went meanwhile; used at the next start
  stage_ = Stage::starting;
  start_up_->on_keys(keys);
  continue_start_up(now);
}

void BoardLink::on_keys_failed(const std::string& why, TimePoint now) {
  if (stage_ != Stage::awaiting_keys) return;
  stage_ = Stage::refused;
  retry_at_ = now + refusal_interval;
  go_down(why);
  say_once(Severity::error, why);
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<TimePoint> BoardLink::deadline() const {
  switch (stage_) {
    case Stage::closed: return std::nullopt;
    case Stage::resyncing: return resync_.deadline();
    case Stage::awaiting_keys: return decoder_.deadline();
    case Stage::refused:
    case Stage::starting:
    case Stage::running: break;
  }
  std::optional<TimePoint> next = decoder_.deadline();
  if (in_flight_) next = earlier(next, in_flight_->deadline);
  if (stage_ == Stage::running && !in_flight_) next = earlier(next, poll_at_);
  if (stage_ == Stage::refused && !in_flight_) next = earlier(next, retry_at_);
  return next;
}

void BoardLink::on_deadline(TimePoint now) {
  if (stage_ == Stage::closed) return;
  if (stage_ == Stage::resyncing) {
    if (auto bytes = resync_.on_deadline(now)) actions_.push(WriteSerial{std::move(*bytes)});
    if (resync_.state() == Resync::State::failed) on_silence();
    return;
  }
  decoder_.on_deadline(now);
  if (decoder_.has_lost_step()) return begin_resync(now);
  if (in_flight_ && now >= in_flight_->deadline) return on_command_timeout(now);
  if (stage_ == Stage::refused && !in_flight_ && now >= retry_at_) return begin_resync(now);
  send_next(now);
}

void BoardLink::on_command_timeout(TimePoint now) {
  ++counters_.command_timeouts;
  if (++consecutive_timeouts_ < max_consecutive_timeouts) return begin_resync(now);
  consecutive_timeouts_ = 0;
  give_up(fmt::format("the serial board answers Echo but not command 0x{:02x}", in_flight_->opcode),
          "does its firmware have Nordic's mesh commands?");
}

void BoardLink::give_up(const std::string& why, const std::string& what_to_check) {
  stage_ = Stage::closed;
  in_flight_.reset();
  go_down(why + ": " + what_to_check);
  actions_.push(ReopenPort{reopen_delay_});
  reopen_delay_ = std::min(reopen_delay_ * 2, max_reopen_delay);
}

void BoardLink::on_silence() {
  if (resync_.octets_seen() == 0)
    return give_up("the serial board answers nothing",
                   "is it Nordic's serial board and powered? Check the cable, ble_mesh.device, "
                   "ble_mesh.flow_control, and that no other program (ModemManager) uses it");
  give_up("the device sends something, but not Nordic's serial protocol",
          "is it the right device? Check ble_mesh.device, ble_mesh.baud_rate, and "
          "ble_mesh.protocol (firmware that only streams positions needs \"cobs\")");
}

void BoardLink::go_down(const std::string& why) {
  urgent_.clear();
  normal_.clear();
  command_.reset();
  if (stage_ == Stage::closed) is_clear_wanted_ = false;
  const bool was_up = std::exchange(is_up_, false);
  if (was_up) said_.clear();
  if (std::exchange(down_reason_, why) == why && !was_up) return;
  actions_.push(LinkIsDown{why});
}

void BoardLink::say_once(Severity severity, const std::string& text) {
  if (said_.size() >= max_said || !said_.insert(text).second) return;
  actions_.push(Notice{severity, text, {}});
}

}  // namespace slamgw::ble
