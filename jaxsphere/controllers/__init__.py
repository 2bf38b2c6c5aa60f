"""Control laws. A law is a function (time, state, memory) -> ControllerOutput; a rollout knows nothing else about it."""
