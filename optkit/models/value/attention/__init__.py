"""The paper's attention network as a value function; needs PyTorch."""
