// SPDX-License-Identifier: Apache-2.0
// An MQTT broker as a pure model, as strict as the specification allows. It gives a session to one
// client at a time and does not notify the old one. Acknowledgements take effect when they arrive,
// and everything takes time on its way. Octets are not modelled.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::test {

/// The callbacks of one connection, in the order in which the broker has sent the packets.
struct Hearing {
  std::function<void(bool is_present)> on_connack = [](bool) {};
  std::function<void(BrokerMessage, std::vector<std::uint32_t>)> on_message =
      [](BrokerMessage, std::vector<std::uint32_t>) {};
  std::function<void(const std::string& filter, bool is_granted)> on_suback = [](const std::string&,
                                                                                 bool) {};
  std::function<void(std::uint64_t number)> on_fence = [](std::uint64_t) {};
  std::function<void()> on_closed = [] {};
};

class BrokerModel {
 public:
  using Connection = std::uint64_t;

  /// MQTT 5 sends a message once for each matching filter, or once with the identifiers of all.
  /// MQTT 3.1.1 sends it once without any, and retained messages whether wanted or not.
  enum class Kind : std::uint8_t { v5_copies, v5_one, v3_1_1 };

  static constexpr std::size_t receive_maximum = 16;

  BrokerModel(unsigned seed, Kind kind) : kind_(kind), random_(seed) {}

  /// Runs all events up to `time`, in steps of a millisecond.
  std::int64_t time_ms() const { return time_ms_; }
  void run_until(std::int64_t time_ms) {
    while (!events_.empty() && events_.begin()->first <= time_ms) {
      auto first = events_.extract(events_.begin());
      time_ms_ = first.key();
      first.mapped()();
    }
    time_ms_ = time_ms;
  }

  // A client's packets. Each takes effect later, in its order.
  Connection connect(const std::string& client, bool is_clean, Hearing hearing) {
    const Connection id = ++last_connection_;
    links_[id] = {client, std::move(hearing), true, time_ms_, time_ms_, true};
    to_broker(id, [this, id, is_clean] { accept(id, is_clean); });
    return id;
  }
  /// Filters with `forbidden` in them are refused.
  void subscribe(Connection id, const std::string& filter, std::uint32_t subscription,
                 bool wants_retained) {
    to_broker(id, [=, this] {
      Session* session = held_by(id);
      if (!session) return;
      const bool is_granted = filter.find("forbidden") == std::string::npos;
      if (is_granted) session->filters[filter] = subscription;
      to_client(id, [=](const Hearing& hearing) { hearing.on_suback(filter, is_granted); });
      if (!is_granted || (!wants_retained && kind_ != Kind::v3_1_1)) return;
      for (const auto& [topic, message] : retained_)
        if (filter_matches(filter, topic))
          to_client(id, [message = message, subscription](const Hearing& hearing) {
            hearing.on_message(message, {subscription});
          });
    });
  }
  void unsubscribe(Connection id, const std::string& filter) {
    to_broker(id, [this, id, filter] {
      if (Session* session = held_by(id)) session->filters.erase(filter);
    });
  }
  void fence(Connection id, std::uint64_t number) {
    to_broker(id, [this, id, number] {
      if (held_by(id))
        to_client(id, [number](const Hearing& hearing) { hearing.on_fence(number); });
    });
  }
  /// Publishes on a connection, or at once as another client.
  void publish(BrokerMessage message, Connection id = 0) {
    if (message.retain) retained_[message.topic] = message;
    message.retain = false;
    if (id == 0) return route(message);
    to_broker(id, [this, id, message] {
      if (held_by(id)) route(message);
    });
  }
  /// An orderly DISCONNECT.
  void disconnect(Connection id, bool is_forgotten) {
    to_broker(id, [this, id, is_forgotten] {
      const bool is_held = held_by(id) != nullptr;
      release(id);
      if (is_held && is_forgotten) sessions_.erase(links_.at(id).client);
    });
    links_.at(id).is_reading = false;
  }
  /// Breaks the connection: packets on their way are lost, each side notices later.
  void cut(Connection id) {
    const auto found = links_.find(id);
    if (found == links_.end() || !found->second.is_open) return;
    found->second.is_open = false;
    at(time_ms_ + delay(), [this, id] { release(id); });
    at(time_ms_ + delay(), [this, id] { close(id); });
  }
  /// Stops its client: it reads nothing; packets that it wrote have left.
  void stop_reading(Connection id, bool is_stopped) {
    Link& link = links_.at(id);
    link.is_reading = !is_stopped;
    if (is_stopped) return;
    for (auto& each : std::exchange(link.unread, {}))
      if (link.is_reading) each(link.hearing);
  }

 private:
  using Ids = std::vector<std::uint32_t>;
  /// A message for one session, as it matched when it came.
  struct Kept {
    std::uint64_t number = 0;
    BrokerMessage message;
    Ids ids;
    bool is_sent = false;
  };
  struct Session {
    std::map<std::string, std::uint32_t> filters;
    std::deque<Kept> unacknowledged;  ///< sent or waiting, oldest first
    Connection holder = 0;
  };
  struct Link {
    std::string client;
    Hearing hearing;
    bool is_open = true;
    std::int64_t broker_has_until_ms = 0;  ///< order on the way to the broker
    std::int64_t client_has_until_ms = 0;
    bool is_reading = true;
    std::vector<std::function<void(const Hearing&)>> unread{};
    bool is_told_closed = false;
  };

  std::int64_t delay() { return std::uniform_int_distribution<std::int64_t>(1, 20)(random_); }
  void at(std::int64_t time_ms, std::function<void()> what) {
    events_.emplace(time_ms, std::move(what));
  }
  void to_broker(Connection id, std::function<void()> what) {
    Link& link = links_.at(id);
    link.broker_has_until_ms = std::max(link.broker_has_until_ms, time_ms_ + delay());
    at(link.broker_has_until_ms, [this, id, what] {
      if (links_.at(id).is_open) what();
    });
  }
  void to_client(Connection id, std::function<void(const Hearing&)> what) {
    Link& link = links_.at(id);
    link.client_has_until_ms = std::max(link.client_has_until_ms, time_ms_ + delay());
    at(link.client_has_until_ms, [this, id, what] { give(id, what); });
  }
  /// Packets on their way when the connection broke may have been read before.
  void give(Connection id, const std::function<void(const Hearing&)>& what) {
    Link& link = links_.at(id);
    if (link.is_told_closed) return;
    if (link.is_reading)
      what(link.hearing);
    else
      link.unread.push_back(what);
  }
  void close(Connection id) {
    give(id, [this, id](const Hearing& hearing) {
      if (!std::exchange(links_.at(id).is_told_closed, true)) hearing.on_closed();
    });
  }

  Session* held_by(Connection id) {
    const auto found = sessions_.find(links_.at(id).client);
    return found != sessions_.end() && found->second.holder == id ? &found->second : nullptr;
  }
  void accept(Connection id, bool is_clean) {
    const std::string& client = links_.at(id).client;
    const bool is_present = sessions_.contains(client) && !is_clean;
    Session& session = sessions_[client];
    if (session.holder != 0) {  // without a DISCONNECT, as Mosquitto 2.0 does
      links_.at(session.holder).is_open = false;
      close(session.holder);
    }
    if (!is_present) session = {};
    session.holder = id;
    to_client(id, [is_present](const Hearing& hearing) { hearing.on_connack(is_present); });
    for (Kept& kept : session.unacknowledged) kept.is_sent = false;
    send_next(session);
  }
  void release(Connection id) {
    if (Session* session = held_by(id)) session->holder = 0;
    links_.at(id).is_open = false;
  }
  void route(const BrokerMessage& message) {
    for (auto& [client, session] : sessions_) {
      for (Ids& ids : copies_for(session, message)) {
        Kept kept{++last_number_, message, std::move(ids)};
        if (message.qos != Qos::at_most_once)
          session.unacknowledged.push_back(std::move(kept));
        else if (session.holder != 0)
          send(session.holder, kept);
      }
      send_next(session);
    }
  }
  /// Sends as many as the client's Receive Maximum allows.
  void send_next(Session& session) {
    if (session.holder == 0) return;
    std::size_t place = 0;
    for (Kept& kept : session.unacknowledged) {
      if (++place > receive_maximum) return;
      if (!std::exchange(kept.is_sent, true)) send(session.holder, kept);
    }
  }
  std::vector<Ids> copies_for(const Session& session, const BrokerMessage& message) const {
    Ids ids;
    for (const auto& [filter, id] : session.filters)
      if (filter_matches(filter, message.topic)) ids.push_back(id);
    if (ids.empty()) return {};
    if (kind_ == Kind::v3_1_1) return {Ids{}};
    if (kind_ == Kind::v5_one) return {ids};
    std::vector<Ids> copies;
    for (const std::uint32_t id : ids) copies.push_back({id});
    return copies;
  }
  /// The client's library acknowledges before it passes the message on. The acknowledgement counts
  /// if the client still has the session when it arrives.
  void send(Connection id, const Kept& kept) {
    to_client(id, [this, id, kept](const Hearing& hearing) {
      to_broker(id, [this, id, number = kept.number] {
        Session* holder = held_by(id);
        if (!holder) return;
        std::erase_if(holder->unacknowledged,
                      [&](const Kept& each) { return each.number == number; });
        send_next(*holder);
      });
      hearing.on_message(kept.message, kept.ids);
    });
  }

  const Kind kind_;
  std::minstd_rand random_;
  std::int64_t time_ms_ = 0;
  std::multimap<std::int64_t, std::function<void()>> events_;
  Connection last_connection_ = 0;
  std::map<Connection, Link> links_;
  std::map<std::string, Session> sessions_;
  std::uint64_t last_number_ = 0;
  std::map<std::string, BrokerMessage> retained_;
};

}  // namespace slamgw::test
