// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/roaming.hpp"

#include <algorithm>
#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

bool Roaming::takes(const Peer& peer, const LocalAddress& local, const Connect& connect,
                    std::uint64_t fingerprint, TimePoint now) {
  const auto waiting = std::ranges::find(waiting_, peer, &WaitingConnect::peer);
  if (waiting != waiting_.end()) {
    if (waiting->connect.client_id != connect.client_id) return true;
    waiting->connect = connect;  // it may want a clean session now
    waiting->fingerprint = fingerprint;
    return true;
  }
  if (connect.clean_session || waiting_.size() >= limits::max_waiting_connects ||
      clients_.find(connect.client_id))
    return false;
  const auto robot = rules_.names.of_client(connect.client_id);
  if (!robot || !is_valid_level(*robot) || !served_elsewhere_(*robot)) return false;
  waiting_.push_back({peer, local, connect, fingerprint, *robot, now + limits::note_patience});
  output_.emit(NoteRequest{Mesh::thread, *robot});
  return true;
}

bool Roaming::keep(const RobotMessage& message, TimePoint now) {
  const auto found = std::ranges::find(waiting_, message.robot, &WaitingConnect::robot);
  if (found == waiting_.end() || found->messages.size() >= limits::max_queued_messages)
    return false;
  found->messages.emplace_back(now, message);
  return true;
}

bool Roaming::is_waiting(const std::string& robot) const {
  return std::ranges::find(waiting_, robot, &WaitingConnect::robot) != waiting_.end();
}

std::vector<RobotMessage> Roaming::WaitingConnect::take_messages(TimePoint now) {
  std::vector<RobotMessage> taken;
  for (auto& [came, message] : std::exchange(messages, {})) {
    message.message.waited += std::chrono::duration_cast<Waited>(now - came);
    taken.push_back(std::move(message));
  }
  return taken;
}

std::optional<Roaming::WaitingConnect> Roaming::take(const std::string& robot) {
  const auto found = std::ranges::find(waiting_, robot, &WaitingConnect::robot);
  if (found == waiting_.end()) return std::nullopt;
  WaitingConnect connect = std::move(*found);
  waiting_.erase(found);
  return connect;
}

std::optional<Roaming::WaitingConnect> Roaming::take_overdue(TimePoint now) {
  if (waiting_.empty() || waiting_.front().until > now) return std::nullopt;
  return take(waiting_.front().robot);
}

std::optional<TimePoint> Roaming::deadline() const {
  if (waiting_.empty()) return std::nullopt;
  return waiting_.front().until;
}

}  // namespace slamgw::mqttsn
