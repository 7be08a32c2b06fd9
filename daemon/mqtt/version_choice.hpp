// SPDX-License-Identifier: Apache-2.0
// Chooses the version of MQTT for the next CONNECT: 5, or 3.1.1 with a broker that does not know 5.
// Pure.
#pragma once

#include <cstdint>

namespace slamgw {

enum class MqttVersion : std::uint8_t { v3_1_1 = 4, v5 = 5 };

/// How an attempt to connect ended without a connection.
enum class ConnectAnswer : std::uint8_t {
  version_refused,  ///< by CONNACK
  closed,           ///< the broker closed the connection and said nothing
  other,            ///< another refusal, no connection, or no answer in time
};

class VersionChoice {
 public:
  /// Some brokers close an MQTT 5 connection without a CONNACK (RabbitMQ before 3.13). A broker
  /// that is killed at that moment does so, too, but hardly twice in a row.
  static constexpr unsigned closings_needed = 2;

  MqttVersion version() const { return version_; }

  /// Returns true when the other version should be tried at once.
  bool on_failed(ConnectAnswer answer) {
    if (version_ == MqttVersion::v3_1_1) {
      if (is_guess_ || answer == ConnectAnswer::version_refused) version_ = MqttVersion::v5;
      return false;
    }
    closings_ = answer == ConnectAnswer::closed ? closings_ + 1 : 0;
    is_guess_ = answer == ConnectAnswer::closed;
    if (closings_ < closings_needed && answer != ConnectAnswer::version_refused) return false;
    version_ = MqttVersion::v3_1_1;
    return true;
  }

  /// Closings before a connection with MQTT 5 say nothing about the broker's version.
  void on_connected() {
    if (version_ == MqttVersion::v5) closings_ = 0;
  }

  /// Call when a connection was lost. After a guess, MQTT 5 is tried again; then one more closing
  /// decides.
  void on_lost() {
    if (is_guess_) version_ = MqttVersion::v5;
  }

 private:
  MqttVersion version_ = MqttVersion::v5;
  bool is_guess_ = false;  ///< 3.1.1 was not asked for by a CONNACK
  unsigned closings_ = 0;  ///< of MQTT 5, in a row
};

}  // namespace slamgw
