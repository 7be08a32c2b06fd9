# SPDX-License-Identifier: Apache-2.0
# Shows the output of a build as one line of progress, and failures in full. Sourced by dev and
# packaging/build-deb.
# shellcheck shell=bash

# show_progress: passes a build's output on. Ninja's steps become one line: rewritten on a terminal, else one in 30 s.
show_progress() {
  local line shown=-30 is_open=''
  while IFS= read -r line; do
    if [[ $line =~ ^\[([0-9]+)/([0-9]+)\]\  ]]; then
      [ "${BASH_REMATCH[1]}" != 0 ] || continue # ninja checks whether files were added
      if [ -t 2 ]; then
        printf '\r\033[Kstep %s of %s' "${BASH_REMATCH[1]}" "${BASH_REMATCH[2]}" >&2
        is_open=yes
      elif [ "$SECONDS" -ge $((shown + 30)) ]; then
        printf 'step %s of %s\n' "${BASH_REMATCH[1]}" "${BASH_REMATCH[2]}" >&2
        shown=$SECONDS
      fi
      continue
    fi
    [ -z "$is_open" ] || printf '\n' >&2
    is_open=''
    printf '%s\n' "$line"
  done
  [ -z "$is_open" ] || printf '\n' >&2
}

# build_quietly LOG COMMAND...: all output goes into LOG; a failure shows it from the first error, or its last 60 lines.
build_quietly() {
  local log=$1 first count
  shift
  if "$@" 2>&1 | tee "$log" | show_progress >/dev/null; then
    count=$(grep -cE ':[0-9]+: warning: ' "$log") || return 0
    printf '%s compiler warnings: %s\n' "$count" "$log" >&2
    return
  fi
  first=$(grep -nm1 -E '^FAILED: |error: |\*\*\* ' "$log" | cut -d: -f1) || true
  if [ -n "$first" ]; then tail -n "+$first" "$log" >&2; else tail -n 60 "$log" >&2; fi
  return 1
}
