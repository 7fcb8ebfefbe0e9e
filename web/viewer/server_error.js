// SPDX-License-Identifier: Apache-2.0
// What went wrong with the source of the numbers, in words for the person.

export class ServerError extends Error {
  constructor(status, {what, where, cure}) {
    super(`${what}\n${where}\nCure: ${cure}`);
    this.status = status;
  }
}
