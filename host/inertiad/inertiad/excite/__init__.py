# SPDX-License-Identifier: Apache-2.0
"""Optimal excitation: motions that minimise the covariance of mass, CoG and inertia within the robot's limits.

    minimise  log tr(W S)  (A)  or  log det(W S) / 10  (D)     S: covariance of mass, CoG, inertia
    over      q(t) = q_0 + B(t) c      quintic B-splines in x y z roll pitch yaw, at rest at both ends
    subject to every limit of constraints.py at every instant
W puts 0.2 % of the mass, 1 mm and 1 % of the mean moment of inertia on a par. Static poses: the same with q free at
every pose and no derivatives.

    request.plan()  the command line's words -> planner.optimal(), shortest(), static_poses(), moves()
                                           -> problem.Problem -> search.search_all()
                                           -> planner.predicted(): checked, driven on elastic cables, rehearsed
"""
