// SPDX-License-Identifier: Apache-2.0
// The messages of QoS 1 and 2 that a client has sent lately, and the exchanges of QoS 2 that are
// open (R75). Recognises a repetition by MsgId, topic and payload (R76). Common clients repeat
// without DUP, and robots send steps that must not count twice. But some clients use one MsgId for
// everything, and often send equal messages.
//
// An equal message is a repetition while the first copy is not acknowledged, or its exchange is
// open. In the window after that, a copy with DUP is a repetition. A copy without DUP is a
// repetition if the client counts its MsgIds, or if the copy comes so late after PUBACK that a lost
// PUBACK explains it. Such a loss is not assumed after PUBCOMP, nor of clients that set DUP. A
// client that has just used a MsgId twice, or has sent more copies than clients repeat, sends new
// messages. In doubt a message goes up twice.
#pragma once

#include <boost/circular_buffer.hpp>
#include <cstdint>
#include <optional>

#include "adapters/mqttsn_udp/limits.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

/// FNV-1a over topic id, its type, QoS, retain and the payload; not over DUP and MsgId. Never 0.
std::uint64_t fingerprint(const Publish& publish);
std::uint64_t fingerprint(ByteView bytes);  ///< over all octets; never 0

class RepeatFilter {
 public:
  struct Entry {
    std::uint64_t fingerprint = 0;
    TimePoint since{};             ///< when it came, later when it was acknowledged
    std::uint64_t receipt_id = 0;  ///< 0: acknowledged
    std::uint16_t topic_id = 0;
    std::uint16_t msg_id = 0;
    std::uint8_t repeats = 0;    ///< without DUP, since it was acknowledged
    bool awaits_pubrel = false;  ///< of QoS 2: its exchange is open
  };

  /// Returns the message that this one repeats, or null. Forgets messages older than the window.
  /// `fingerprint` is that of `publish`.
  const Entry* find(const Publish& publish, std::uint64_t fingerprint, TimePoint now);
  /// Call for REGISTER and SUBSCRIBE, which also show how the client makes its MsgIds.
  void on_request(std::uint16_t msg_id);
  /// Adds a new message. If there is no room, forgets the oldest one that is acknowledged. An
  /// exchange takes the place of the one with its MsgId. If too many are open, the oldest whose
  /// message is safe ends: its PUBREL may never come.
  void add(const Entry& entry);
  /// Marks the message as acknowledged. Returns null if none waits for this receipt.
  const Entry* on_safe(std::uint64_t receipt_id, TimePoint now);
  /// Forgets and returns the message: its repetition is a new message.
  std::optional<Entry> on_refused(std::uint64_t receipt_id);
  /// Ends the exchange, but recognises a late copy of its message for a while. Returns false if no
  /// exchange with this MsgId has a message that is safe.
  bool on_pubrel(std::uint16_t msg_id, TimePoint now);
  void clear();
  /// True if the client gives each message its own MsgId, one after the other. This is kept over a
  /// restart: else the first messages that the client repeats without DUP would go up twice.
  bool counts_ids() const;
  void set_counts_ids();
  /// Oldest first; some may be older than the window.
  const auto& entries() const { return entries_; }

 private:
  bool is_repeat(const Entry& known, const Publish& publish, TimePoint now) const;
  void make_room_for(const Entry& exchange);
  /// Returns the newest entry for which `is_wanted` holds, or null.
  template <class Predicate>
  Entry* newest(Predicate is_wanted);

  // Not a std::deque: an empty one has 576 octets, for each of thousands of clients.
  using Entries = boost::circular_buffer_space_optimized<Entry>;
  Entries entries_{Entries::capacity_type(limits::max_repeats)};  // oldest first
  std::uint16_t last_msg_id_ = 0;                                 // of a request or new message
  std::uint16_t counted_ids_ = 0;  // small steps to the next one, up to min_counted_ids
  bool reuses_ids_ = false;        // the last new message had the MsgId of another
  bool sets_dup_ = false;          // the client marks repetitions
};

}  // namespace slamgw::mqttsn
