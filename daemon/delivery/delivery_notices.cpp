// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/delivery_notices.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw {
namespace {

std::string words_of(const Refusal& refusal) {
  return refusal.code == 0 ? refusal.why : fmt::format("{} (0x{:02x})", refusal.why, refusal.code);
}

std::string advice_for(const Refusal& refusal) {
  constexpr int not_authorised = 0x87;
  return refusal.code == not_authorised ? "; check the broker's access control list" : "";
}

Notice of_refusal(Severity severity, std::string text) {
  return {severity, std::move(text), {}, Occasion::broker_refusal};
}

}  // namespace

Notice RefusalNotices::on_refused_topic(const std::string& topic, const Refusal& refusal) {
  return of_refusal(
      Severity::warning,
      fmt::format("the broker refuses messages on {}: {}; they are kept and retried{}", topic,
                  words_of(refusal), advice_for(refusal)));
}

Notice RefusalNotices::on_accepted(const std::string& topic) {
  return of_refusal(Severity::notice,
                    fmt::format("the broker accepts messages on {} again", topic));
}

Notice RefusalNotices::on_undelivered(Fate fate, const std::string& topic, std::size_t bytes,
                                      const Refusal& refusal) {
  const bool is_dead = fate == Fate::dead_letter;
  const char* const next =
      is_dead ? "`slam-gatewayctl store list` shows it, `store resend` sends it again"
      : fate == Fate::not_acknowledged
          ? "it was not acknowledged"
          : "the gateway publishes on the topic again at its next change";
  return of_refusal(
      Severity::error,
      fmt::format("a message of {} octets on {} {}: {}; {}", bytes, topic,
                  is_dead ? "is a dead letter now" : "was not delivered", words_of(refusal), next));
}

std::optional<Notice> RefusalNotices::on_unacknowledged(const BrokerMessage& message,
                                                        const Refusal& refusal) {
  if (!unacknowledged_.insert(SlotSums::slot(message.topic)).second) return std::nullopt;
  return of_refusal(Severity::warning, fmt::format("messages of QoS 0 on {} are dropped: {}",
                                                   message.topic, words_of(refusal)));
}

std::optional<Notice> StoreTrouble::on_failed(Way way, const std::string& error, TimePoint now) {
  std::string& trouble = way == Way::write ? write_ : read_;
  const std::string why = (way == Way::write ? "written: " : "read: ") + error;
  ++failures_;
  trouble = "it cannot be " + why;
  if (!throttle_.on_event(now)) return std::nullopt;
  is_said_ = true;
  return Notice{Severity::error,
                fmt::format("the store cannot be {}; messages wait in memory, and robots wait "
                            "for the broker's acknowledgement",
                            why),
                {}};
}

std::optional<Notice> StoreTrouble::on_worked(Way way) {
  std::string& trouble = way == Way::write ? write_ : read_;
  if (trouble.empty()) return std::nullopt;
  trouble.clear();
  if (!why().empty() || !std::exchange(is_said_, false)) return std::nullopt;
  return Notice{Severity::notice, "the store works again", {}};
}

}  // namespace slamgw
