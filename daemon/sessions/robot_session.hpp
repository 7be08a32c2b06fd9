// SPDX-License-Identifier: Apache-2.0
// One robot's MQTT session at the broker, which the broker gives to one gateway at a time
// (docs/fleet.md). Decides when the session is opened, which of its messages are for this gateway,
// and what is lost with it. Part of RobotSessions, which limits how many sessions open at once.
#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "daemon/core/protocol_machine.hpp"
#include "daemon/sessions/session_action.hpp"
#include "daemon/sessions/session_names.hpp"

namespace slamgw::sessions {

class RobotSession {
 public:
  /// Limit of messages whose fence is not answered yet; more are dropped and counted. A fence takes
  /// one round trip to the broker. Mosquitto keeps 1000 messages for a session unless it is
  /// configured, and may send those with QoS 2 at once.
  static constexpr std::size_t max_unfenced = 1024;
  /// A session that is lost within `quick_loss` of its start, more than `free_losses` times in a
  /// row, is opened again after growing waits.
  static constexpr std::chrono::seconds quick_loss{10};
  static constexpr unsigned free_losses = 3;
  static constexpr std::chrono::seconds first_flap_wait{3};
  static constexpr std::chrono::seconds longest_flap_wait{60};
  /// A session is contested after this many losses without a quiet minute between them, while its
  /// robot is heard here. Losses to one of our own gateways count only when they are quick.
  static constexpr unsigned contested_losses = 2;
  static constexpr std::chrono::seconds quiet_minute{60};
  /// A broker that shuts down closes its connections one after the other, within this time.
  static constexpr std::chrono::seconds broker_end{3};
  /// Waits after a failed CONNECT. While another gateway shows the robot, and the robot has been
  /// silent here, the longest follows the first: a CONNECT of this gateway would end one of the
  /// other. If the failed one did, no gateway holds the session: the wait is below `stale_after`.
  static constexpr std::chrono::seconds first_retry{1};
  static constexpr std::chrono::seconds longest_retry{20};
  /// A robot that is heard after such a silence, while another gateway shows it, was elsewhere.
  static constexpr std::chrono::seconds silence{3};
  /// Waiting messages are refused when no gateway has held the session for longer than this. A
  /// gateway that takes the session while another one still sorts cannot know which are old.
  static constexpr std::chrono::seconds stale_after{25};
  /// A marker goes to the robot's mailbox and comes back after the messages that the broker had. A
  /// message with QoS 2 comes one round trip later than others, so there are two markers.
  static constexpr unsigned marker_rounds = 2;
  /// Time for a marker to come back. Messages that come before the last marker are stale.
  static constexpr std::chrono::seconds marker_patience{10};
  /// A subscriber waits this long for the session and the broker's answer; less than the 10 s after
  /// which devices ask again (MQTT-SN 1.2 section 7.2).
  static constexpr std::chrono::seconds subscribe_patience{8};
  /// Retained messages come within this time after the broker has granted their filter.
  static constexpr std::chrono::seconds retained_patience{10};
  /// Waits after which filters that the broker has refused are asked for again.
  static constexpr std::chrono::seconds first_ask_wait{1};
  static constexpr std::chrono::seconds longest_ask_wait{60};
  /// A filter is asked for again when the broker has not answered for this time.
  static constexpr std::chrono::seconds longest_answer{30};
  /// A filter is refused when the broker has ended this many connections instead of answering it.
  static constexpr unsigned max_fatal_losses = 2;
  /// The same limit for a filter that was granted before. Such a filter is subscribed on each
  /// connection, and a broker that restarts ends some of these.
  static constexpr unsigned max_fatal_losses_of_granted = 10;
  /// Time for the note to come after its subscription was granted, and in all.
  static constexpr std::chrono::milliseconds note_patience{300};
  static constexpr std::chrono::seconds longest_note_wait{2};
  static constexpr std::size_t max_note_octets = 65536;
  /// Limit of filters to unsubscribe at the next CONNECT; with more the session starts clean. Also
  /// the limit of UNSUBSCRIBEs that are repeated when the connection is lost.
  static constexpr std::size_t max_given_up = 64;

  /// `sorting`: the robot starts a clean session, and its waiting messages are refused before the
  /// broker forgets them.
  enum class State : std::uint8_t { detached, queued, opening, sorting, attached };

  /// Subscription identifiers (MQTT 5). Those of the robot's own filters are made from the filters,
  /// so that they are the same at each gateway.
  static constexpr std::uint32_t command_id = 1;
  static constexpr std::uint32_t own_id = 2;  ///< mailbox and note
  static constexpr std::uint32_t first_filter_id = 3;
  static constexpr std::uint32_t last_filter_id = 268435455;

  /// Shared by all sessions.
  struct Counts {
    std::size_t opening = 0;  ///< CONNECTs under way, and sessions that sort
    std::size_t held = 0;
    std::uint64_t attached = 0;
    std::uint64_t lost = 0;
    std::uint64_t fenced_off = 0;  ///< messages whose fence was not answered before the loss
    std::uint64_t dropped = 0;     ///< messages beyond max_unfenced, or invalid in the mailbox
  };

  /// `unheld_since`: no gateway is known to have held the session since then; nothing: another
  /// gateway holds it.
  RobotSession(std::string robot, const SessionNames& names, ActionQueue<SessionAction>& actions,
               Counts& counts, std::optional<TimePoint> unheld_since = {})
      : robot_(std::move(robot)),
        names_(names),
        actions_(actions),
        counts_(counts),
        unheld_since_(unheld_since) {}

  State state() const { return state_; }
  bool is_held() const { return state_ == State::attached; }
  /// Returns true while a message waits for its fence. The broker may not have it any more.
  bool has_unfenced() const { return !unfenced_.empty(); }
  bool is_opening() const { return state_ == State::opening || state_ == State::sorting; }
  /// Returns true when the session has a connection, or one is being opened.
  bool is_connected() const { return is_held() || is_opening(); }
  /// Returns true while another client repeatedly takes the session of a robot that is heard here.
  bool is_contested() const { return is_contested_; }
  /// Returns true when the broker does not let this gateway use the robot's client id.
  bool is_refused() const { return is_refused_; }
  /// Returns the earliest time for CONNECT, which is past unless the session failed or flaps.
  TimePoint opens_at() const { return opens_at_; }
  /// Returns true when the session is detached, and its robot was heard or is kept.
  bool is_wanted() const { return is_wanted_ && state_ == State::detached; }

  /// Call when the robot was heard by radio. `is_elsewhere`: another living gateway shows it.
  void on_heard(bool is_elsewhere, TimePoint now);
  /// Call when the robot has sent a request. A robot that was elsewhere does not wait for the next
  /// try.
  void note_heard(bool is_elsewhere, TimePoint now);
  /// Asks for the session at this time although the robot was not heard; nothing: no longer.
  void set_keeps_at(std::optional<TimePoint> when) { keeps_at_ = when; }
  std::optional<TimePoint> keeps_at() const { return keeps_at_; }
  /// Call when another gateway shows the robot, which it does after it has taken the session.
  void on_shown_elsewhere(TimePoint now);
  /// Asks for the session of a robot that no other gateway shows any more.
  void keep(TimePoint now);
  /// `when`: no gateway has held the session since then; nothing: another living gateway holds it.
  void set_unheld_since(std::optional<TimePoint> when) { unheld_since_ = when; }
  std::optional<TimePoint> unheld_since() const { return unheld_since_; }
  /// When another client took the session last; nothing when that was not so, or is not known.
  std::optional<TimePoint> lost_at() const { return lost_at_; }
  void set_queued() { enter(State::queued); }
  /// Sends CONNECT.
  void open();
  /// Sends DISCONNECT. `is_forgotten`: the broker forgets the session too.
  void close(bool is_forgotten);
  /// Sends DISCONNECT at the daemon's end. Answers no request: robots ask the next process.
  void leave();

  /// Subscribes for the robot; answered once by FilterAnswered. `may_wait`: false when the broker
  /// gives no answers, so that the filter is granted at once.
  void subscribe(const std::string& filter, Qos qos, bool may_wait, TimePoint now);
  /// Restores a subscription that the robot has made before, perhaps at another gateway.
  void resume(const std::string& filter, Qos qos, TimePoint now);
  void unsubscribe(const std::string& filter);
  /// Starts a clean session: nothing of the robot's former session counts.
  void begin_clean(TimePoint now);
  /// Call when another gateway serves the robot: what the robot has subscribed is known there only.
  void on_given_up();
  /// Returns true for a session that was only kept: its robot has no subscriptions here, was not
  /// heard, and this gateway never held the session. If the broker has none, nothing needs one.
  bool is_unused() const {
    return filters_.empty() && heard_at_ == TimePoint{} && held_since_ == TimePoint{};
  }
  bool has_filter(const std::string& filter) const { return filters_.contains(filter); }
  /// Filters of the robot and of the gateway itself that the broker refuses. They stay, and are
  /// asked for again.
  const std::set<std::string>& refused_filters() const { return refused_; }
  /// Returns false if no filter matches the topic, and the broker's session has no others.
  bool may_want(const std::string& topic) const;
  /// Grants the filters of subscribers that wait for the broker, if their time ends by `end`.
  void grant_waiting(TimePoint end = TimePoint::max());
  /// Reads the robot's note, and asks for the session if it is not held. Answered by NoteRead.
  void read_note(TimePoint now);
  /// Asks the broker whether the session is still held; answered by SessionProven, or lost.
  void prove();
  /// Answers a waiting reader with `note`. Has no effect when there is none.
  void end_note(Bytes note);

  /// Call when the gateway uses another broker, which may have an older session of the robot.
  void on_other_broker(TimePoint now);
  void on_attached(bool is_present, bool is_v5, TimePoint now);
  /// `is_elsewhere`: another living gateway shows the robot.
  void on_attach_failed(bool is_elsewhere, TimePoint now);
  void on_refused() { is_refused_ = true; }
  /// No other client has taken the session when the broker is gone, or this side has ended the
  /// connection. All CONNECTs fail while the broker is gone, so a failed one does not delay the
  /// next. `unheld_since`: when the session may have been lost.
  void on_detached(LossReason why, TimePoint unheld_since, TimePoint now);
  /// Call when the broker was lost: a session that was lost just before was not taken by another
  /// client, and that loss does not count. Returns false when there was no such loss.
  bool forgive_loss(TimePoint now);
  void on_subscribed(const std::string& filter, bool is_granted, TimePoint now);
  void on_message(BrokerMessage message, std::span<const std::uint32_t> ids, TimePoint now);
  void on_fence(std::uint64_t number, TimePoint now);

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  struct Filter {
    Qos qos = Qos::at_most_once;
    std::uint32_t id = 0;
    bool is_standing = false;               ///< the broker has granted it on this connection
    bool was_granted = false;               ///< on any connection, perhaps at another gateway
    bool wants_retained = false;            ///< the next SUBSCRIBE brings retained messages
    std::optional<TimePoint> answer_due{};  ///< the robot waits for an answer
    TimePoint retained_until{};             ///< retained messages are for the robot until then
    unsigned fatal_losses = 0;
  };
  /// A message that came on this connection, until its fence shows that it is this gateway's.
  struct Unfenced {
    std::uint64_t fence = 0;
    BrokerMessage message;
    std::vector<std::uint32_t> ids;  ///< of the filters that its copies came for, if known
    bool is_unasked = false;
    bool is_stale = false;
    bool is_answered = false;
    bool awaits_copy = false;  ///< see may_have_late_copy()
    bool has_waited = false;   ///< one fence longer, for another copy
    TimePoint came{};
  };

  void enter(State state);
  bool is_flapping(TimePoint now) const;
  Filter& filter_of(const std::string& filter, Qos qos);
  std::uint32_t make_id(const std::string& filter) const;
  void subscribe_own(const std::string& topic, bool wants_retained);
  void subscribe_to_commands();
  void unsubscribe_given_up();
  void ask(const std::string& filter, Filter& entry, TimePoint now);
  void on_refused_filter(const std::string& filter, TimePoint now);
  void ask_again(TimePoint now);
  bool is_own(const std::string& filter) const;
  void blame_unanswered();
  bool wants_retained(const BrokerMessage& message, TimePoint now) const;
  bool is_copy(const BrokerMessage& message, std::span<const std::uint32_t> ids) const;
  bool may_have_late_copy(const BrokerMessage& message, std::uint32_t id) const;
  bool is_copy_to_come(const Unfenced& one) const;
  bool hears_all_commands() const;
  Qos qos_at_broker(const std::string& filter, Qos qos) const;
  bool is_given_up(std::uint32_t id) const;
  /// Returns the robot's filter with this identifier, or null.
  const Filter* find_filter(std::uint32_t id) const;
  Unfenced* find_copy(const BrokerMessage& message, std::uint32_t id);
  void join(Unfenced& copy, const BrokerMessage& message, std::uint32_t id, bool is_unasked);
  bool is_marker(const BrokerMessage& message) const;
  void end_sorting();
  void send_marker(TimePoint now);
  void on_marker(TimePoint now);
  void begin_sorting(TimePoint now);
  void purge_when_sorted();
  void drop_unfenced();
  void release(TimePoint now);
  void pass_on(Unfenced& one);
  void on_note(BrokerMessage message);
  void count_loss(TimePoint now);
  void set_contested(bool is_contested);

  const std::string robot_;
  const SessionNames& names_;
  ActionQueue<SessionAction>& actions_;
  Counts& counts_;
  State state_ = State::detached;
  bool is_wanted_ = false;
  std::optional<TimePoint> keeps_at_;
  bool is_v5_ = false;
  bool is_clean_due_ = false;  ///< the session must start clean
  bool is_purge_due_ = false;  ///< the next CONNECT asks the broker to forget the session
  bool is_opened_clean_ = false;
  bool knows_all_ = false;  ///< the broker's session has no filters besides `filters_`
  std::map<std::string, Filter> filters_;
  // Lists, because an empty std::deque holds half a KiB for each of thousands of robots.
  std::list<std::string> asked_;            ///< SUBSCRIBEs without an answer, in their order
  std::optional<TimePoint> answers_until_;  ///< then those in `asked_` are sent again
  std::set<std::string> refused_;
  std::optional<TimePoint> asks_again_at_;  ///< for `refused_`
  std::chrono::seconds ask_wait_ = first_ask_wait;
  /// Unsubscribed filters, each with the fence after its UNSUBSCRIBE; 0: to be unsubscribed at the
  /// next CONNECT.
  std::map<std::string, std::uint64_t> given_up_;
  std::list<Unfenced> unfenced_;  ///< in the order in which they came
  std::uint64_t last_fence_ = 0;
  std::uint64_t proof_ = 0;  ///< the fence that answers prove(); 0: none
  std::optional<TimePoint> unheld_since_;
  std::string marker_;  ///< not empty: messages that come before it are stale
  unsigned markers_back_ = 0;
  std::optional<TimePoint> marker_until_;
  std::optional<TimePoint> note_until_;  ///< set while a reader waits for the note
  TimePoint held_since_{};
  TimePoint heard_at_{};  ///< while the session was not held
  TimePoint opens_at_{};
  std::chrono::seconds retry_ = first_retry;
  std::optional<TimePoint> lost_at_;
  unsigned losses_ = 0;        ///< without a quiet minute between them
  unsigned quick_losses_ = 0;  ///< of these, in a row
  TimePoint quiet_at_{};       ///< end of the quiet minute, unless the session is lost again
  bool is_contested_ = false;
  bool is_refused_ = false;
};

}  // namespace slamgw::sessions
