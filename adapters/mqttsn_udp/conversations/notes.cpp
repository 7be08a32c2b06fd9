// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/notes.hpp"

#include <utility>

#include "adapters/mqttsn_udp/clients/session_codec.hpp"
#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

/// At once after a change, for on_deadline() to see when it came.
std::optional<TimePoint> Notes::deadline() const {
  if (!output_.has_noteworthy()) return std::nullopt;
  return due_.value_or(TimePoint{});
}

void Notes::on_deadline(TimePoint now) {
  if (!output_.has_noteworthy()) return;
  if (!due_) due_ = now + limits::note_interval;
  if (now < *due_) return;
  for (const std::string& id : output_.take_noteworthy(limits::notes_a_turn)) {
    if (ClientSession* session = clients_.find(id)) update(*session, now);
  }
  if (!output_.has_noteworthy()) due_.reset();
}

void Notes::update(ClientSession& session, TimePoint now) {
  Bytes note;
  std::uint64_t hash = 0;
  if (!session.is_clean) {
    note = encode_session(to_note(to_snapshot(session, now)));
    if (note.size() > limits::max_note_octets) return;
    hash = fingerprint(note);
  }
  if (std::exchange(session.note_hash, hash) == hash) return;
  output_.emit(NoteChanged{Mesh::thread, session.robot, std::move(note)});
}

}  // namespace slamgw::mqttsn
