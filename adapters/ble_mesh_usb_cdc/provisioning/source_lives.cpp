// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/source_lives.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::ble {

void SourceLives::on_source_wanted(const SourceWanted& wanted, TimePoint now) {
  RadioLife next = *life();
  const bool is_empty = wanted.addresses == 0;
  const bool is_other = !next.radio.empty() && next.radio != wanted.radio;
  if (is_other) next.kind = RadioKind::unknown;
  if (is_empty && !is_other && !next.radio.empty() && !wanted.was_cleared)
    next.kind = RadioKind::forgets;
  next.radio = wanted.radio;
  const std::uint32_t room = nodes_.source_room();
  if ((is_empty || is_other) && unused_ != next.number) {
    begin_life(next, settings_.address +
                         (is_empty ? room : std::min<std::uint32_t>(room, wanted.addresses)));
    unused_ = next.number;
  }
  if (next != *life()) nodes_.change().life = next;
  unanswered_ = wanted.addresses;
  if (unused_ != next.number || nodes_.is_saved()) answer(now);
}

void SourceLives::answer(TimePoint now) {
  const std::uint16_t addresses = *std::exchange(unanswered_, std::nullopt);
  const std::uint16_t count = addresses > 0 ? addresses : nodes_.source_room();
  const int last = settings_.address + count - 1;
  const int source = std::clamp<int>(life()->source, settings_.address, last);
  radio_.use_source(static_cast<std::uint16_t>(source), count, now);
}

void SourceLives::begin_life(RadioLife& life, std::uint32_t end) {
  const std::uint16_t last = life.source == 0 ? settings_.address : life.source;
  const bool had_address = life.number > 0 && last >= settings_.address;
  life.source =
      had_address && last + 1U < end ? static_cast<std::uint16_t>(last + 1) : settings_.address;
  ++life.number;
  if (!had_address || life.source != settings_.address) return;
  notify(Severity::warning,
         fmt::format("the addresses for the radio's lives are used up after life {}: the "
                     "gateway sends from 0x{:04x} again, which robots may ignore; switch robots "
                     "that do not obey off and on",
                     life.number - 1, life.source));
}

void SourceLives::on_stored(const std::string& problem, TimePoint now) {
  if (!unanswered_) return;
  if (!problem.empty()) return radio_.delay_source(problem);
  if (!nodes_.is_saved()) return;
  answer(now);
}

void SourceLives::on_link_up(const LinkIsUp& up) {
  unused_.reset();
  if (life() == nullptr) return;
  RadioLife next = *life();
  if (next.radio != up.radio) next.kind = RadioKind::unknown;
  if (up.has_kept_address) next.kind = RadioKind::keeps;
  next.radio = up.radio;
  next.number = std::max(next.number, std::uint32_t{1});
  // The radio may have kept its address from a life that this file does not know.
  next.source = std::max(next.source, up.source);
  if (next != *life()) nodes_.change().life = next;
}

RadioKind SourceLives::kind() const { return life() ? life()->kind : RadioKind::unknown; }

bool SourceLives::is_reused() const { return life() && number() > nodes_.source_room(); }

std::string SourceLives::description() const {
  std::string text = fmt::format("sends from 0x{:04x}", link_.source);
  if (number() > 0) text += fmt::format(" (life {})", number());
  switch (kind()) {
    case RadioKind::unknown: return text;
    case RadioKind::forgets: return "forgets at power-off, " + text;
    case RadioKind::keeps: return "keeps its address at power-off, " + text;
  }
  return text;
}

}  // namespace slamgw::ble
