// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/units.h"

haarlight::Watts wrong() { return haarlight::Watts(5.0) + 3.0; }
