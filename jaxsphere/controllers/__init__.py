"""Control laws. A law is a function (time, state, memory) -> Command; a rollout knows nothing else about it."""
