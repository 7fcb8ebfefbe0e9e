// SPDX-License-Identifier: Apache-2.0
// What went wrong with the source of the numbers, in words for the user.

export class ServerError extends Error {
  constructor(status, {what, where, cure}) {
    super(`${what}\n${where}\nHint: ${cure}`);
    this.status = status;
  }
}
