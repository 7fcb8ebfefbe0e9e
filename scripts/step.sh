# SPDX-License-Identifier: Apache-2.0
# To be sourced: a step of a long job, quiet unless it fails. Needs $logs, a folder.

step() { # step NAME COMMAND...: with its time; shows the log's end when it fails
  local name=$1 start=$SECONDS
  shift
  printf '%-46s' "$name"
  if ! "$@" >"$logs/step.log" 2>&1; then
    printf 'FAILED\n'
    tail -n 20 "$logs/step.log" | sed 's/^/    /' >&2
    exit 1
  fi
  printf '%4d s\n' $((SECONDS - start))
}
