// SPDX-License-Identifier: Apache-2.0
// The messages to one client: the queue, and the requests that await the client's answer.
// Values only; Downlink and the classes beside it change them.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/clients/topic_table.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/messages.hpp"
#include "daemon/core/round_trip.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

/// The time to wait before a request to one client is repeated: learned from the smoothed round
/// trip of its answers and the variation (RFC 6298). Answers to repeated requests are ambiguous and
/// teach no round trip (Karn's rule).
class RetransmissionTimeout {
 public:
  /// The wait before the first answer: ACK_TIMEOUT of RFC 7252, for networks of this kind.
  static constexpr Duration initial = std::chrono::seconds{2};
  /// A Thread end device that sleeps between its polls hears a message up to a second late (the
  /// poll period of Nordic's sleepy MQTT-SN examples); RFC 6298 has the same lower bound.
  static constexpr Duration shortest = std::chrono::seconds{1};
  /// Smaller differences between round trips do not matter (G of RFC 6298).
  static constexpr Duration granularity = std::chrono::milliseconds{100};

  /// The wait after the first transmission of a request, at most `longest`.
  Duration first(Duration longest) const;
  /// The wait after repetition number `repeats` (from 1), when the wait `last` brought no answer.
  /// The first repetitions come at an even pace, because a lost datagram is their common reason;
  /// then they slow down.
  static Duration next(Duration last, unsigned repeats, Duration longest);

  /// Call when the client has answered a request that was sent once.
  void on_answer(Duration round_trip);
  /// Call when the client has answered a repeated request, with the times since its first and its
  /// last copy. Unless `since_last` fits an answer to the last copy, the next waits grow. They grow
  /// until an answer to the first copy, which is not ambiguous, comes in time.
  void on_ambiguous_answer(Duration since_first, Duration since_last);

 private:
  RoundTrip round_trip_{granularity};
  Duration timeout_ = initial;
};

/// A message under `<prefix>/server/<robot>/<type>`, whose outcome is reported exactly once.
struct Command {
  CommandId id = CommandId::none;  ///< none: from before a restart
  std::string robot;               ///< the robot's name when the command came
  std::string type;
  TimePoint came{};
  bool is_reported = false;
};

/// One message on its way to one client.
struct Outgoing {
  std::shared_ptr<const BrokerMessage> message;
  Qos qos = Qos::at_most_once;  ///< min(message, granted)
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t predefined_id = 0;
  std::shared_ptr<Command> command;  ///< may be null
  std::uint16_t msg_id = 0;       ///< not 0: it was sent under this id, and is sent again with DUP
  std::uint8_t yields = 0;        ///< how often it yielded to another message
  bool was_refused_once = false;  ///< it was refused, and is sent again only once (R86)
  std::size_t octets() const { return message->topic.size() + message->payload.size(); }
  void rename(const NewName& new_name);
};

/// Messages that wait, oldest first. A std::vector, because an empty std::deque takes 576 octets
/// for each of thousands of clients.
using DeliveryQueue = std::vector<Outgoing>;
/// Removes and returns a message. An empty queue keeps no memory.
Outgoing take(DeliveryQueue& queue, std::size_t index);

/// A request that awaits its answer, and when it is repeated (MQTT-SN 1.2 section 6.13).
struct Attempt {
  std::uint16_t msg_id = 0;
  TimePoint begun{};  ///< its first transmission
  TimePoint sent{};   ///< its last transmission
  Duration wait{};    ///< after the last transmission
  unsigned repeats = 0;
  bool is_withheld = false;              ///< the last repeat did not leave: the allowance was spent
  std::optional<TimePoint> repeat_at{};  ///< nothing: it rests

  /// True until the first wait has brought no answer. A fresh request holds back the next ones.
  bool is_fresh() const { return repeats == 0; }
};

/// The PUBLISH of QoS 1 or 2 that awaits its PUBACK or PUBREC: one for each client (R91).
struct Publishing {
  Outgoing what;
  std::uint16_t topic_id = 0;
  Attempt attempt;
};

/// A REGISTER that awaits its REGACK.
struct Registering {
  std::uint16_t topic_id = 0;
  Attempt attempt;
};

/// A topic whose messages the client does not answer. They wait; other topics go on.
struct SetAside {
  std::string topic;
  unsigned failures = 0;             ///< each one doubles the pause
  std::optional<TimePoint> until{};  ///< nothing: the topic is tried again
  bool ends_when_heard = false;      ///< the client sent nothing at all: the pause has no other end
};

struct Delivery {
  DeliveryQueue queue;
  std::unique_ptr<Publishing> publishing;  ///< usually null, which saves 160 octets
  std::vector<Registering> registering;    ///< at most max_open_registers, at most one fresh
  /// PUBRELs that await their PUBCOMP: the client has the messages.
  std::vector<Attempt> releasing;   ///< at most max_open_releases, oldest first
  std::vector<SetAside> set_aside;  ///< at most max_set_aside, oldest first
  /// MsgIds of failed QoS 2 commands: a late PUBREC gets no PUBREL, so they are not carried out.
  std::vector<std::uint16_t> abandoned;  ///< at most max_abandoned, oldest first
  std::uint16_t last_msg_id = 0;
  std::uint16_t base_msg_id = 0;  ///< later MsgIds were sent to the present address only
  RetransmissionTimeout timeout;
  std::optional<TimePoint> paused_until;  ///< the client said "congestion" (T_WAIT)
  bool is_stalled = false;                ///< a PUBLISH was not answered: commands only (R133)
  bool is_half_proven = false;            ///< a PINGREQ with the client id came from this address
  bool refuses_dup = false;               ///< the client answers 0x03 to DUP, as RIOT's emcute does
  bool forgets_ids_asleep = false;        ///< the client forgets topic ids, as simon622's does
  bool is_set_aside_reported = false;     ///< the operator had the notice, once for each client
  std::size_t wake_budget = 0;            ///< messages that this wake-up may still bring (R122)
  std::unique_ptr<Outgoing> last_qos0;    ///< to repeat after "invalid topic id" (R86)
  std::uint16_t last_qos0_id = 0;

  /// Renames the topics of all of the above.
  void rename(const NewName& new_name);
};

// The MsgIds of the gateway's own requests to one client (R90): each client has its own numbers.

/// Returns an unforeseeable number.
using RandomSource = std::function<std::uint16_t()>;

/// Makes the next MsgIds follow `random`, which is unforeseeable: an answer to one of them shows
/// that the client receives.
void restart_message_ids(Delivery& delivery, std::uint16_t random);
/// Whether this MsgId was drawn since restart_message_ids().
bool is_since_restart(const Delivery& delivery, std::uint16_t msg_id);

/// Some clients keep MsgIds in signed 16-bit numbers and fail on negative ones.
inline constexpr std::uint16_t highest_msg_id = 0x7fff;
/// Skips the MsgIds that a killed process may have used since the session was saved.
void skip_message_ids(Delivery& delivery);
/// Returns the next MsgId, from 1 to highest_msg_id: never one that still awaits its answer.
std::uint16_t next_message_id(Delivery& delivery);

}  // namespace slamgw::mqttsn
