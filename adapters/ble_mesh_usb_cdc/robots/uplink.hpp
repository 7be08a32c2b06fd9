// SPDX-License-Identifier: Apache-2.0
// The way up: turns a robot's access message into a report, and the report's receipt into the
// STATUS that the robot waits for. Part of BleMesh.
#pragma once

#include <optional>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/robots/robots.hpp"

namespace slamgw::ble {

struct UplinkCounters {
  std::uint64_t reports = 0;
  std::uint64_t repeats = 0;
  std::uint64_t rejected = 0;
  std::uint64_t unknown_opcodes = 0;
  std::uint64_t left_to_others = 0;  ///< another gateway serves the robot
  std::uint64_t statuses_sent = 0;
};

class Uplink : private MeshPart {
 public:
  /// All references must outlive this object.
  Uplink(const MeshPart& shared, Robots& robots, Downlink& downlink)
      : MeshPart(shared), robots_(robots), downlink_(downlink) {}

  /// Takes a message from `robot` that does not answer a configuration request.
  void on_message(Robot& robot, const MessageReceived& message, TimePoint now);
  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  /// Another gateway serves the robot: messages that are not acknowledged yet stay so here.
  void on_given_up(Robot& robot);
  /// This gateway serves the robot from now on. Reports a message that the robot repeats because no
  /// gateway has answered it.
  void on_session_held(Robot& robot, TimePoint now);
  /// Counts a message that can't be used, and logs the reason from time to time.
  void reject(std::uint16_t source, std::string_view why, TimePoint now);

  const UplinkCounters& counters() const { return counters_; }

 private:
  /// A message of one of the vendor models.
  struct VendorReport {
    Robot& robot;
    VendorModel model;
    const MessageReceived& message;
    ByteView params;
    std::optional<std::uint8_t> number = {};  ///< of its transaction
  };

  void on_vendor_message(Robot& robot, VendorMessage kind, const MessageReceived& message,
                         ByteView params, TimePoint now);
  void on_set(const VendorReport& set, TimePoint now);
  void on_status(Robot& robot, Opcode status, TimePoint now);
  void take_up(Robot& robot, const UnservedSet& unserved);
  RepeatFilter::Verdict judge(const VendorReport& set, TimePoint now) const;
  void leave_to_others(Robot& robot, VendorMessage kind, const MessageReceived& message,
                       TimePoint now);
  void forget(Inbox& inbox);
  void report(const VendorReport& what, std::uint64_t receipt_id);
  void report_repeat(const VendorReport& set);
  void send_status(const Robot& robot, std::uint16_t element, Bytes status, TimePoint now);
  const std::string& type_of(VendorModel model) const;

  Robots& robots_;
  Downlink& downlink_;
  std::uint64_t last_receipt_ = 0;
  LogThrottle reject_throttle_;
  UplinkCounters counters_;
};

}  // namespace slamgw::ble
