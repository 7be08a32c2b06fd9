// SPDX-License-Identifier: Apache-2.0
#include "tests/support/transcript.hpp"

#include <algorithm>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace slamgw::test {
namespace {

constexpr std::string_view directory = SLAMGW_VECTORS "/nordic_board/";

std::vector<std::string> words_of(std::string_view text) {
  std::istringstream in{std::string(text)};
  std::vector<std::string> words;
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

std::uint8_t octet_of(const std::string& word) {
  const bool is_hex =
      word.size() == 2 && word.find_first_not_of("0123456789abcdef") == std::string::npos;
  if (!is_hex) throw std::runtime_error("not an octet: " + word);
  return static_cast<std::uint8_t>(std::stoul(word, nullptr, 16));
}

/// Removes ` * n` from the end and returns n.
std::size_t take_repeats(std::vector<std::string>& words) {
  if (words.size() < 3 || words[words.size() - 2] != "*") return 1;
  const std::size_t repeats = std::stoul(words.back());
  words.resize(words.size() - 2);
  return repeats;
}

RecordedPacket packet_of(const std::vector<std::string>& words) {
  RecordedPacket packet;
  for (const std::string& word : words) {
    packet.is_defined.push_back(word != "..");
    packet.octets.push_back(word == ".." ? std::uint8_t{0} : octet_of(word));
  }
  if (packet.octets.empty() || packet.octets.size() != 1u + packet.octets[0]) {
    throw std::runtime_error("a packet's length octet is wrong");
  }
  return packet;
}

RecordedMessage message_of(const std::vector<std::string>& words) {
  if (words.size() < 5) throw std::runtime_error("a message on air has too few fields");
  RecordedMessage message;
  message.source = static_cast<std::uint16_t>(std::stoul(words[0], nullptr, 16));
  message.destination = static_cast<std::uint16_t>(std::stoul(words[1], nullptr, 16));
  message.ttl = octet_of(words[2]);
  message.is_device_key = words[3] == "device:";
  std::transform(words.begin() + 4, words.end(), std::back_inserter(message.payload), octet_of);
  return message;
}

/// Reads one file, line by line, for one release.
class Reader {
 public:
  Reader(std::string_view file, std::string_view release) : release_(release) {
    const std::string path = std::string(directory) + std::string(file);
    std::ifstream in(path);
    if (!in) throw std::runtime_error("cannot read " + path);
    for (std::string line; std::getline(in, line);) {
      ++line_;
      try {
        on_line(line);
      } catch (const std::exception& error) {
        throw std::runtime_error(path + ":" + std::to_string(line_) + ": " + error.what());
      }
    }
  }

  std::vector<Transcript> transcripts;
  std::vector<std::string> releases;

 private:
  void on_line(std::string_view line) {
    if (line.empty() || line[0] == '#') return;
    const std::size_t space = line.find(' ');
    const std::string_view kind = line.substr(0, space);
    const std::string_view rest = space == line.npos ? "" : line.substr(space + 1);
    if (kind == "releases") {
      releases = words_of(rest);
    } else if (kind == "==") {
      on_transcript(rest);
    } else if (transcripts.empty()) {
      throw std::runtime_error("before the first transcript");
    } else if (kind == "--") {
      std::string_view text = rest;
      is_of_release_ = take_mark(text);
      situation_ = text;
    } else {
      if (is_of_release_) on_exchange(kind, rest);
    }
  }

  void on_transcript(std::string_view rest) {
    const std::size_t colon = rest.find(": ");
    if (colon == rest.npos) throw std::runtime_error("a transcript needs a name and a title");
    transcripts.push_back(
        {std::string(rest.substr(0, colon)), std::string(rest.substr(colon + 2)), {}});
    situation_.clear();
    is_of_release_ = true;
  }

  void on_exchange(std::string_view kind, std::string_view rest) {
    if (!take_mark(rest)) return;
    std::vector<std::string> words = words_of(rest);
    if (kind == "~") {
      exchange().on_air = message_of(words);
      return;
    }
    const std::size_t repeats = take_repeats(words);
    if (kind == "<") {
      std::vector<RecordedPacket>& answers = exchange().answers;
      answers.insert(answers.end(), repeats, packet_of(words));
    } else if (kind == ">") {
      begin_exchange();
      for (std::size_t i = 0; i < repeats; ++i) {
        std::transform(words.begin(), words.end(), std::back_inserter(exchange().command),
                       octet_of);
      }
    } else {
      throw std::runtime_error("an unknown line");
    }
  }

  /// Removes `[releases] ` from the front. Returns false for another release.
  bool take_mark(std::string_view& text) const {
    if (text.empty() || text[0] != '[') return true;
    const std::size_t end = text.find("] ");
    if (end == text.npos) throw std::runtime_error("a mark without its end");
    const std::vector<std::string> marked = words_of(text.substr(1, end - 1));
    text.remove_prefix(end + 2);
    return std::find(marked.begin(), marked.end(), release_) != marked.end();
  }

  void begin_exchange() { transcripts.back().exchanges.push_back({situation_, line_, {}, {}, {}}); }

  Exchange& exchange() {
    if (transcripts.back().exchanges.empty()) begin_exchange();
    return transcripts.back().exchanges.back();
  }

  std::string_view release_;
  std::size_t line_ = 0;
  std::string situation_;
  bool is_of_release_ = true;
};

}  // namespace

bool RecordedPacket::matches(std::span<const std::uint8_t> packet) const {
  if (packet.size() != octets.size()) return false;
  for (std::size_t i = 0; i < octets.size(); ++i) {
    if (is_defined[i] && packet[i] != octets[i]) return false;
  }
  return true;
}

std::string RecordedPacket::text() const {
  static constexpr char digits[] = "0123456789abcdef";
  std::string out;
  for (std::size_t i = 0; i < octets.size(); ++i) {
    if (i > 0) out += ' ';
    out += is_defined[i] ? digits[octets[i] >> 4] : '.';
    out += is_defined[i] ? digits[octets[i] & 15] : '.';
  }
  return out;
}

std::vector<std::string> releases_of(std::string_view file) { return Reader(file, "").releases; }

std::vector<Transcript> read_transcripts(std::string_view file, std::string_view release) {
  Reader reader(file, release);
  const auto& releases = reader.releases;
  if (std::find(releases.begin(), releases.end(), release) == releases.end()) {
    throw std::runtime_error(std::string(file) + " is not about release " + std::string(release));
  }
  return std::move(reader.transcripts);
}

Transcript read_transcript(std::string_view file, std::string_view name, std::string_view release) {
  std::vector<Transcript> all = read_transcripts(file, release);
  const auto found =
      std::find_if(all.begin(), all.end(), [&](const Transcript& t) { return t.name == name; });
  if (found == all.end()) {
    throw std::runtime_error(std::string(file) + " has no transcript " + std::string(name));
  }
  return std::move(*found);
}

}  // namespace slamgw::test
