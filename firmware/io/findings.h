// SPDX-License-Identifier: Apache-2.0
/// What is good or not about an estimate, in words an engineer acts on, and the verdict: the worst severity.
///
///   no_estimate              stop        nothing was identified
///   short_record             care        fewer than 50 windows
///   misfit                   care        no payload explains the forces; or the estimate moves more than its sigma allows
///   contact                  care        an announced payload comes into contact: the share carried so far is in the estimate
///   impossible_body          care, stop  no body is near
///   broken_force_sensor      care        the estimate goes on without it
///   correction_beyond_prior  care        a sensor's error is over 4 of its stated sigmas
///   poorly_observable        care        sigma is more than half of the prior's
///   payload_changed          good        the numbers are those of the last payload
/// The names, and the words where both have a finding, are those of inertiactl fit and report. What needs the whole record
/// is found there only: mistakes of the description, runs that disagree, force sensors that do not agree, what is confounded.
/// No state, any thread, no heap, under 20 us.
#ifndef IPE_FINDINGS_H
#define IPE_FINDINGS_H

#include "estimator.h"

#include <stddef.h>

typedef enum { IPE_SEVERITY_GOOD = 1, IPE_SEVERITY_CARE = 2, IPE_SEVERITY_STOP = 3 } ipe_severity_t;

enum { IPE_FINDINGS_MAX = 12 };

typedef struct {
    const char* name;  ///< for programs
    ipe_severity_t severity;
    char says[256];
    char evidence[256];  ///< members of a JSON object: numbers behind it, SI units
    const char* remedy;  ///< what helps; empty: nothing needs to be done
} ipe_finding_t;

/// The worst first.
typedef struct {
    int n;
    ipe_finding_t item[IPE_FINDINGS_MAX];
} ipe_findings_t;

/// Findings of the estimate as last published. Writes all of found.
void ipe_findings_of(const ipe_estimator_t* e, const ipe_config_t* config, ipe_findings_t* found);

/// The worst severity; good where nothing is found.
ipe_severity_t ipe_findings_verdict(const ipe_findings_t* found);

/// The estimate has left its start behind and is not held in a misfit.
bool ipe_findings_has_converged(const ipe_estimator_t* e);

/// "good", "care", "stop". Static storage.
const char* ipe_severity_name(ipe_severity_t severity);

/// The verdict as a headline for people. Static storage.
const char* ipe_severity_headline(ipe_severity_t severity);

#endif
