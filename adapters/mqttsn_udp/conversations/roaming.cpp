// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/roaming.hpp"

#include <algorithm>
#include <utility>

namespace slamgw::mqttsn {

bool Roaming::takes(const Peer& peer, const LocalAddress& local, const Connect& connect,
                    std::uint64_t fingerprint, TimePoint now) {
  if (std::ranges::find(waiting_, peer, &WaitingConnect::peer) != waiting_.end()) return true;
  if (connect.clean_session || waiting_.size() >= max_waiting || clients_.find(connect.client_id))
    return false;
  const auto robot = rules_.names.of_client(connect.client_id);
  if (!robot || !is_valid_level(*robot) || !served_elsewhere_(*robot)) return false;
  waiting_.push_back({peer, local, connect, fingerprint, *robot, now + patience});
  output_.emit(SignOfLife{Mesh::thread, *robot});
  return true;
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

std::optional<SessionSnapshot> Roaming::give_up(const std::string& robot, TimePoint now) {
  ClientSession* session = clients_.find_robot(robot);
  if (!session) return std::nullopt;
  std::optional<SessionSnapshot> kept;
  if (!session->is_clean) {
    kept = to_snapshot(*session, now);
    kept->peer.reset();
    kept->state = ClientState::disconnected;
    std::erase_if(kept->messages,
                  [](const MessageSnapshot& message) { return message.command_age.has_value(); });
  }
  session->reported_presence = Presence::offline;  // the other gateway reports it
  lifecycle_.expel(*session, "the robot moved to another gateway", now);
  return kept;
}

}  // namespace slamgw::mqttsn
