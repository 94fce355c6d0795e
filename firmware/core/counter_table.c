// SPDX-License-Identifier: Apache-2.0
#include "counter_table.h"

#define AT(member) offsetof(ipe_pipeline_t, member)
#define REJECTED IPE_COUNTER_REJECTED
#define BAD IPE_COUNTER_BAD
#define INCOMPLETE IPE_COUNTER_INCOMPLETE

static const ipe_counter_t COUNTER[] = {
    {"decode.frames", AT(decode.n_frames), 0},
    {"decode.decoded", AT(decode.n_decoded), 0},
    {"decode.unknown_id", AT(decode.n_unknown), 0},
    {"decode.remote", AT(decode.n_remote), 0},
    {"decode.error_frame", AT(decode.n_error), 0},
    {"decode.bad_length", AT(decode.n_bad_length), BAD},
    {"decode.signal_not_finite", AT(decode.n_nonfinite), BAD},
    {"decode.signal_out_of_range", AT(decode.n_out_of_range), BAD},
    {"group.imu.complete", AT(sample_assembler[IPE_IMU].n_complete), 0},
    {"group.imu.incomplete", AT(sample_assembler[IPE_IMU].n_incomplete), BAD | INCOMPLETE},
    {"group.imu.lost", AT(sample_assembler[IPE_IMU].n_lost), BAD | INCOMPLETE},
    {"group.imu.counter_jumps", AT(sample_assembler[IPE_IMU].n_jumps), BAD},
    {"group.imu.used_frames", AT(sample_assembler[IPE_IMU].n_used), 0},
    {"group.imu.dropped_frames", AT(sample_assembler[IPE_IMU].n_dropped), 0},
    {"group.imu.duplicate_frames", AT(sample_assembler[IPE_IMU].n_duplicate), BAD},
    {"group.force.complete", AT(sample_assembler[IPE_FORCE].n_complete), 0},
    {"group.force.incomplete", AT(sample_assembler[IPE_FORCE].n_incomplete), BAD | INCOMPLETE},
    {"group.force.lost", AT(sample_assembler[IPE_FORCE].n_lost), BAD | INCOMPLETE},
    {"group.force.counter_jumps", AT(sample_assembler[IPE_FORCE].n_jumps), BAD},
    {"group.force.used_frames", AT(sample_assembler[IPE_FORCE].n_used), 0},
    {"group.force.dropped_frames", AT(sample_assembler[IPE_FORCE].n_dropped), 0},
    {"group.force.duplicate_frames", AT(sample_assembler[IPE_FORCE].n_duplicate), BAD},
    {"group.position.complete", AT(sample_assembler[IPE_POSITION].n_complete), 0},
    {"group.position.incomplete", AT(sample_assembler[IPE_POSITION].n_incomplete), BAD | INCOMPLETE},
    {"group.position.lost", AT(sample_assembler[IPE_POSITION].n_lost), BAD | INCOMPLETE},
    {"group.position.counter_jumps", AT(sample_assembler[IPE_POSITION].n_jumps), BAD},
    {"group.position.used_frames", AT(sample_assembler[IPE_POSITION].n_used), 0},
    {"group.position.dropped_frames", AT(sample_assembler[IPE_POSITION].n_dropped), 0},
    {"group.position.duplicate_frames", AT(sample_assembler[IPE_POSITION].n_duplicate), BAD},
    {"stuck.imu.refused", AT(stuck_sensor.n_stuck[IPE_IMU]), REJECTED | BAD},
    {"stuck.force.refused", AT(stuck_sensor.n_stuck[IPE_FORCE]), BAD},
    {"stuck.force.unknown", AT(stuck_sensor.n_unknown), BAD},
    {"stuck.position.refused", AT(stuck_sensor.n_stuck[IPE_POSITION]), BAD},
    {"clock.imu.steps", AT(clock[IPE_IMU].n_steps), BAD},
    {"clock.force.steps", AT(clock[IPE_FORCE].n_steps), BAD},
    {"clock.position.steps", AT(clock[IPE_POSITION].n_steps), BAD},
    {"clock.unsettled", AT(n_unsettled), REJECTED},
    {"pace.imu.lost", AT(sample_timing[IPE_IMU].n_lost), BAD},
    {"pace.imu.dropped", AT(sample_timing[IPE_IMU].n_dropped), REJECTED},
    {"pace.imu.restarts", AT(sample_timing[IPE_IMU].n_restarts), BAD},
    {"pace.force.lost", AT(sample_timing[IPE_FORCE].n_lost), BAD},
    {"pace.force.dropped", AT(sample_timing[IPE_FORCE].n_dropped), 0},
    {"pace.force.restarts", AT(sample_timing[IPE_FORCE].n_restarts), BAD},
    {"pace.position.lost", AT(sample_timing[IPE_POSITION].n_lost), BAD},
    {"pace.position.dropped", AT(sample_timing[IPE_POSITION].n_dropped), 0},
    {"pace.position.restarts", AT(sample_timing[IPE_POSITION].n_restarts), BAD},
    {"align.imu.samples", AT(align.n_samples[IPE_IMU]), 0},
    {"align.imu.reordered", AT(align.n_reordered[IPE_IMU]), 0},
    {"align.imu.duplicate", AT(align.n_duplicate[IPE_IMU]), REJECTED | BAD},
    {"align.imu.backwards", AT(align.n_backwards[IPE_IMU]), REJECTED | BAD},
    {"align.imu.restarts", AT(align.n_restarts[IPE_IMU]), BAD},
    {"align.imu.not_finite", AT(align.n_nonfinite[IPE_IMU]), REJECTED | BAD},
    {"align.imu.bad_quaternion", AT(align.n_bad_quaternion), REJECTED | BAD},
    {"align.force.samples", AT(align.n_samples[IPE_FORCE]), 0},
    {"align.force.reordered", AT(align.n_reordered[IPE_FORCE]), 0},
    {"align.force.duplicate", AT(align.n_duplicate[IPE_FORCE]), BAD},
    {"align.force.backwards", AT(align.n_backwards[IPE_FORCE]), BAD},
    {"align.force.restarts", AT(align.n_restarts[IPE_FORCE]), BAD},
    {"align.force.not_finite", AT(align.n_nonfinite[IPE_FORCE]), BAD},
    {"align.force.spikes", AT(align.n_spikes[IPE_FORCE]), BAD},
    {"align.position.samples", AT(align.n_samples[IPE_POSITION]), 0},
    {"align.position.reordered", AT(align.n_reordered[IPE_POSITION]), 0},
    {"align.position.duplicate", AT(align.n_duplicate[IPE_POSITION]), BAD},
    {"align.position.backwards", AT(align.n_backwards[IPE_POSITION]), BAD},
    {"align.position.restarts", AT(align.n_restarts[IPE_POSITION]), BAD},
    {"align.position.not_finite", AT(align.n_nonfinite[IPE_POSITION]), BAD},
    {"align.position.unreachable", AT(align.n_unreachable), BAD},
    {"align.position.spikes", AT(align.n_spikes[IPE_POSITION]), BAD},
    {"align.rows", AT(align.n_rows), 0},
    {"align.overrun", AT(align.n_overrun), REJECTED | BAD},
    {"align.force.missing", AT(align.n_missing[IPE_FORCE]), REJECTED},
    {"align.force.late", AT(align.n_late[IPE_FORCE]), REJECTED},
    {"align.position.missing", AT(align.n_missing[IPE_POSITION]), 0},
    {"align.position.late", AT(align.n_late[IPE_POSITION]), 0},
    {"motion.rows", AT(motion.n_rows), 0},
    {"motion.carried", AT(motion.n_carried), 0},
    {"motion.no_position", AT(motion.n_no_position), REJECTED},
    {"motion.unsettled", AT(motion.n_unsettled), 0},
    {"motion.position_refused", AT(motion.n_positions_refused), BAD},
    {"motion.starts", AT(motion.n_starts), 0},
    {"wrench.rows", AT(wrench.n_rows), 0},
    {"wrench.bad_geometry", AT(wrench.n_geometry), REJECTED | BAD},
    {"wrench.slack", AT(wrench.n_slack), 0},
    {"wrench.overload", AT(wrench.n_overload), 0},
    {"window.rows", AT(estimator.n_rows), 0},
    {"window.windows", AT(window.n_windows), 0},
    {"window.restarts", AT(window.n_restarts), BAD},
    {"window.backwards", AT(window.n_backwards), REJECTED | BAD},
    {"detect.held", AT(estimator.change_detector.n_held), 0},
    {"detect.changes", AT(estimator.change_detector.n_changes), 0},
    {"detect.rejected", AT(estimator.change_detector.n_rejected), 0},
    {"detect.misfit", AT(estimator.change_detector.n_misfit), 0},
    {"expect.taken", AT(n_announced_taken), 0},
    {"expect.other", AT(n_announced_other), 0},
    {"expect.failed", AT(n_announced_failed), 0},
    {"expect.missed", AT(n_announced_missed), 0},
    {"rls.weighted", AT(estimator.n_weighted), 0},
    {"rls.unknown_force", AT(estimator.n_unknown_force), 0},
    {"rls.updates", AT(estimator.rls.n_updates), 0},
    {"rls.not_finite", AT(estimator.rls.n_nonfinite), BAD},
    {"estimate.refused", AT(estimator.n_refused), BAD},
    {"estimate.frozen", AT(n_frozen), 0},
};

enum { COUNTERS = sizeof COUNTER / sizeof COUNTER[0] };

const ipe_counter_t* ipe_counter_table(unsigned index)
{
    return index < COUNTERS ? &COUNTER[index] : NULL;
}

static uint64_t value_of(const ipe_pipeline_t* p, const ipe_counter_t* counter)
{
    return *(const uint64_t*)((const char*)p + counter->offset);
}

const char* ipe_pipeline_counter(const ipe_pipeline_t* p, unsigned index, uint64_t* value)
{
    if (index >= COUNTERS) { return NULL; }
    *value = value_of(p, &COUNTER[index]);
    return COUNTER[index].name;
}

uint64_t ipe_pipeline_counter_sum(const ipe_pipeline_t* p, unsigned flags)
{
    uint64_t sum = 0;
    for (unsigned i = 0; i < COUNTERS; ++i) {
        if (COUNTER[i].flags & flags) { sum += value_of(p, &COUNTER[i]); }
    }
    return sum;
}
