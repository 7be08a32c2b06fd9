// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/session_keeper.hpp"

#include <fmt/format.h>

#include <functional>
#include <utility>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

SessionKeeper::SessionKeeper(boost::asio::io_context& io, SnGateway& gateway, SessionStore& store,
                             std::function<void(bool)> on_saved)
    : gateway_(gateway),
      store_(store),
      on_saved_(std::move(on_saved)),
      timer_(io),
      patience_timer_(io),
      later_timer_(io) {
  gateway_.answer_when_saved();
  store_.watch(std::bind_front(&SessionKeeper::on_written, this));
}

std::optional<Notice> SessionKeeper::restore(TimePoint now) {
  std::size_t taken = 0;
  std::vector<SessionStore::Change> useless;
  for (const auto& [id, content] : store_.load()) {
    const auto snapshot = decode_session(content);
    if (snapshot && gateway_.restore(*snapshot, now)) {
      ++taken;
    } else {
      useless.push_back({id, std::nullopt});
    }
  }
  if (taken == 0 && useless.empty()) return std::nullopt;
  Notice restored;
  if (taken > 0) restored.text = fmt::format("restored {} MQTT-SN sessions", taken);
  if (!useless.empty()) {
    restored.severity = Severity::warning;
    restored.text += fmt::format(
        "{}{} stored MQTT-SN sessions can't be restored (another robot's name, no room, or "
        "damaged): these clients have to connect again",
        taken > 0 ? "; " : "", useless.size());
    store_.save(std::move(useless));
  }
  return restored;
}

void SessionKeeper::save_soon() {
  const bool do_answers_wait = gateway_.has_unsaved_answers();
  if (do_answers_wait && !is_watching_) watch_disk();
  if (do_answers_wait && !store_.is_busy()) {
    if (!std::exchange(is_urgent_, true)) save_after({});
  } else if (!is_armed_ && gateway_.has_changed()) {
    save_after(interval);
  }
}

void SessionKeeper::save_after(std::chrono::milliseconds delay) {
  is_armed_ = true;
  timer_.after(delay, [this] {
    is_armed_ = is_urgent_ = false;
    if (!store_.is_busy()) save_some();
    save_soon();
  });
}

void SessionKeeper::watch_disk() {
  is_watching_ = true;
  patience_timer_.after(write_patience, [this] {
    is_watching_ = false;
    on_saved_(false);
  });
}

void SessionKeeper::on_written(bool is_written) {
  is_watching_ = false;
  patience_timer_.cancel();
  on_saved_(is_written);
}

void SessionKeeper::save_some() {
  const TimePoint now = std::chrono::steady_clock::now();
  std::vector<SessionStore::Change> changes;
  for (std::string& id : gateway_.take_changed(sessions_a_write)) {
    std::optional<Bytes> content;
    if (auto snapshot = gateway_.snapshot(id, now)) {
      if (!is_stopping_ && leave_out_young_commands(*snapshot)) save_again_later(id);
      content = encode_session(std::move(*snapshot));
    }
    changes.push_back({std::move(id), std::move(content)});
  }
  if (!changes.empty()) store_.save(std::move(changes));
}

void SessionKeeper::save_again_later(std::string id) {
  later_.push_back(std::move(id));
  if (later_.size() > 1) return;
  later_timer_.after(limits::stored_command_age, [this] {
    for (const std::string& each : std::exchange(later_, {})) gateway_.set_changed(each);
    save_soon();
  });
}

void SessionKeeper::stop() {
  is_stopping_ = true;
  later_timer_.cancel();
  timer_.cancel();
  patience_timer_.cancel();
  gateway_.set_all_dirty();
  while (gateway_.has_changed()) save_some();
}

}  // namespace slamgw::mqttsn
