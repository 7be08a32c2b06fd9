// SPDX-License-Identifier: Apache-2.0
// The second half of a QoS 2 delivery: PUBREL until PUBCOMP (MQTT-SN 1.2 section 6.6). The client
// has the message by then, so a PUBREL that stays unanswered holds nothing back.
#pragma once

#include "adapters/mqttsn_udp/conversations/retransmission.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class Release {
 public:
  Release(Output& output, const Retransmission& retransmission)
      : output_(output), retransmission_(retransmission) {}

  void begin(ClientSession& session, std::uint16_t msg_id, TimePoint now);
  /// A repeated PUBREC: answered, and the repetitions go on as they were. False when there is no
  /// such release.
  bool on_pubrec(ClientSession& session, std::uint16_t msg_id);
  /// False when there is no such release.
  static bool on_pubcomp(Delivery& delivery, std::uint16_t msg_id, TimePoint now);

  /// The next message waits for this PUBCOMP, as long as it can come any moment.
  static bool is_fresh(const Delivery& delivery);
  /// Nothing is sent until `resume()`.
  static void rest(Delivery& delivery);
  /// Sends what rests, once the client was heard since it was last sent.
  void resume(ClientSession& session, TimePoint now);

  /// Repeats what is due. True when the client has not answered and said nothing else meanwhile.
  bool on_time(ClientSession& session, TimePoint now);
  static std::optional<TimePoint> next_time(const Delivery& delivery);

 private:
  Output& output_;
  const Retransmission& retransmission_;
};

}  // namespace slamgw::mqttsn
